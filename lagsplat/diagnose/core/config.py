"""Settings of a diagnosis."""

from dataclasses import dataclass


@dataclass
class DiagnoseConfig:
    """Everything that decides a diagnosis, less the recordings."""

    input_hold: str  # how inputs act between samples: linear or zoh
    columns: dict[
        str, str
    ]  # names of a trajectory's columns where they differ: {t: time, q0: angle, u0: torque}
    joints: list[str] | None  # of a MuJoCo model: those that are the coordinates, null for all
    actuators: list[str] | None  # of a MuJoCo model: those that are the inputs, null for all
    without: list[str]  # effects that are left out of the catalogue
    window_periods: float  # length of the stretches that are simulated, in natural periods
    steps_per_period: float  # least number of integration steps in one natural period
    identify_iterations: int  # of the fit of a sim to its own recordings
    identify_ridge: float  # of the regression that this fit starts from
    families: int  # effects that are fitted in full, the most promising of each score test
    places: int  # coordinates or inputs tried for each of them
    starts: int  # beginnings of each fit
    iterations: int  # of each fit
    tolerance: float  # gain of a step below which a fit has ended, as a share of the misfit
    always: list[str]  # effects that are fitted whatever the score test says
    temper: float  # samples of a residual that count as one
    potential: float  # how far the sim's potential may be off, as a share
    damping: float  # how far its damping rate, as a share of the natural angular frequency
    inputs: float  # how far the gain of each input, as a share
    offset: float  # how large an offset force, as a share of the motion's rms acceleration
    warp: float  # how much the coordinates may be bent over their range, as a share of it
    learned: float  # by how much larger all these are where the sim was learned from a film
    own_longest_s: float  # of a sim's own recordings, how many seconds are looked at, held-out part or not
    materiality: float  # least share of the gap that an effect must take away to be named
    prior_none: float  # probability, before the data, that nothing is missing
    prior_unknown: float  # probability, before the data, that what is missing is not in the catalogue
    unexplained: float  # share of the excess misfit left at which `unknown` is as likely as not
    further_from: float  # share left from which a further effect is believed, if it leaves next to nothing
    further: float  # share of the excess misfit that a second effect must take away

    def __post_init__(self) -> None:
        if self.input_hold not in ("linear", "zoh"):
            raise ValueError(
                f"diagnose.input_hold={self.input_hold!r} is linear or zoh (held between samples)"
            )
        for name in (
            "own_longest_s",
            "window_periods",
            "steps_per_period",
            "tolerance",
            "temper",
            "identify_ridge",
        ):
            if getattr(self, name) <= 0:
                raise ValueError(f"diagnose.{name}={getattr(self, name)} must be positive")
        for name in ("families", "places", "starts", "iterations", "identify_iterations"):
            if getattr(self, name) < 1:
                raise ValueError(f"diagnose.{name}={getattr(self, name)} must be at least 1")
        for name in ("potential", "damping", "inputs", "offset", "warp"):
            if not 0 < getattr(self, name) < 1:
                raise ValueError(f"diagnose.{name}={getattr(self, name)} is a share in (0, 1)")
        for name in ("materiality", "prior_none", "prior_unknown", "unexplained", "further", "further_from"):
            if not 0 < getattr(self, name) < 1:
                raise ValueError(f"diagnose.{name}={getattr(self, name)} is a share in (0, 1)")
        if self.prior_none + self.prior_unknown >= 1:
            raise ValueError("diagnose.prior_none and prior_unknown leave no probability for the effects")
