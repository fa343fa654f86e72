"""Settings of what is measured far past the training window. Torch-free, so that planning stays fast."""

from dataclasses import dataclass


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class GuaranteeConfig:
    """From where, and with what, a learned law is asked whether it always comes to rest.

    Raises:
        ValueError: a value outside its domain.
    """

    starts: int
    """Rollouts from all around, at rest and moving."""
    far: float
    """Their distance, in lengths of the longest encoded state."""
    force: float
    """Largest held force: the one that holds the law at this share of the longest encoded state."""
    duration_s: float
    """Longest they may take to settle."""
    settled: float
    """Distance from the equilibrium that counts as settled, as a share of the longest encoded state."""

    def __post_init__(self) -> None:
        """Check the domains."""
        for key, value in vars(self).items():
            _require(f"guarantee.{key}", value, value > 0, "must be positive")


@dataclass  # not frozen, for the same reason
class ExtrapolationConfig:
    """How far models are rolled out, where they are looked at, and when they count as out of the chart.

    Every value lives in ``conf/extrapolation/*.yaml``.

    Raises:
        ValueError: a value outside its domain.

    Source: paper, Table "Extrapolation past the training window".
    """

    horizon_s: float
    """Length of the free rollout past the last training frame."""
    shown_s: float
    """Its first part, looked at in whole."""
    looks: int
    """Short looks after that, at times that grow by a constant factor up to the horizon."""
    look_periods: float
    """Length of a look, in natural periods."""
    history_periods: float
    """Training frames from which a law's state is estimated, in natural periods."""
    shift_frames: float
    """Frames are also compared with what the model shows up to this many frames earlier or later."""
    shift_steps: int
    """How many shifts between the two are tried, where a model can draw between frames."""
    range_error: float
    """A predicted frame is out of range if the autoencoder reproduces it worse than the worst training frame
    by this factor."""
    range_distance: float
    """... or if its state lies further from the nearest training state than this share of their rms."""
    least_inside: float
    """Share of predicted frames in range below which no physics is read off them."""
    guarantee: GuaranteeConfig

    def __post_init__(self) -> None:
        """Check the domains."""
        for key in (
            "horizon_s", "shown_s", "looks", "look_periods", "history_periods", "range_error",
            "range_distance",
        ):  # fmt: skip
            _require(key, getattr(self, key), getattr(self, key) > 0, "must be positive")
        _require("shift_frames", self.shift_frames, self.shift_frames >= 0, "must not be negative")
        odd = self.shift_steps > 0 and self.shift_steps % 2 == 1
        _require("shift_steps", self.shift_steps, odd, "must be odd, so that no shift is among them")
        share = self.least_inside
        _require("least_inside", share, 0 <= share <= 1, "is a share: choose it in [0, 1]")
        longer = self.horizon_s >= self.shown_s
        _require("horizon_s", self.horizon_s, longer, f"must be at least shown_s={self.shown_s}")


def _require(key: str, value: object, holds: bool, rule: str) -> None:
    if not holds:
        raise ValueError(
            f"extrapolation.{key}={value} {rule}; set it in conf/extrapolation or with "
            f"extrapolation.{key}=..."
        )
