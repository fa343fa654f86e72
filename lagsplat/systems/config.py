"""Values of a simulated arm: its mechanics, its inputs and its pictures. Imports no torch."""

from dataclasses import dataclass


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise ValueError(message)


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class ArmConfig:
    """Mechanics of a planar hanging arm; every list holds one value a segment, base first.

    Lengths [m], masses [kg], rotary inertias [kg m^2]. ``bending_stiffness`` [N m/rad] acts on the bending
    angle of a whole segment, ``extension_stiffness`` [J] on its strain; a hardening ``h`` turns the restoring
    force ``k x`` into ``k x (1 + h x^2)``. Each damping coefficient is its stiffness times
    ``retardation_s`` (Kelvin-Voigt). Behind a segment sits a rigid link: the connector, then the tip cap.
    ``chamber_area`` [m^2], ``chamber_offset`` [m] from the backbone; ``chamber_limit`` is the ratio of the
    reinforcing fibre's length to the chamber's rest length: the bore narrows as the chamber stretches.
    """

    length: list[float]
    half_width: float
    mass: list[float]
    bending_stiffness: list[float]
    bending_hardening: float
    extension_stiffness: list[float]
    extension_hardening: float
    retardation_s: float
    chamber_area: list[float]
    chamber_offset: float
    chamber_limit: float
    link_length: list[float]
    link_mass: list[float]
    gravity: float

    def __post_init__(self) -> None:
        n = len(self.length)
        for name in (
            "mass",
            "bending_stiffness",
            "extension_stiffness",
            "chamber_area",
            "link_length",
            "link_mass",
        ):
            values = getattr(self, name)
            _require(
                len(values) == n,
                f"arm.{name} has {len(values)} values for {n} segments (arm.length): give one a segment, "
                "base first.",
            )
        for name in ("length", "mass", "bending_stiffness", "extension_stiffness", "chamber_area"):
            _require(
                all(value > 0 for value in getattr(self, name)),
                f"arm.{name} = {getattr(self, name)} must be positive: a segment without it has no dynamics.",
            )
        _require(self.half_width > 0, f"arm.half_width = {self.half_width} m must be positive.")
        _require(
            self.chamber_limit > 3**0.5,
            f"arm.chamber_limit = {self.chamber_limit} must exceed sqrt(3) = 1.732: below it a pressurised "
            "chamber shortens instead of lengthening.",
        )
        _require(
            min(self.bending_hardening, self.extension_hardening, self.retardation_s) >= 0,
            "arm.bending_hardening, arm.extension_hardening and arm.retardation_s must not be negative: the "
            "arm would soften without bound or gain energy.",
        )


@dataclass
class SimulationConfig:
    """A recording to simulate. Counts in frames, ``dt_s`` [s], pressures [atm], ``view_width`` [m].

    ``camera_noise_levels`` is the standard deviation of the camera in grey levels of 255 and
    ``pressure_noise_atm`` that of the logged pressures; the arm itself feels the pressures without noise.
    ``hold_atm`` is the pose the drive settles into before all pressures are released.
    """

    height: int
    width: int
    view_width: float
    n_frames: int
    rest_frames: int
    hold_frames: int
    tail_frames: int
    dt_s: float
    drive_low_hz: float
    drive_high_hz: float
    drive_max_atm: float
    hold_atm: list[float]
    pressure_noise_atm: float
    camera_noise_levels: float
    rtol: float
    atol: float
    arm: ArmConfig

    def __post_init__(self) -> None:
        _require(
            min(self.height, self.width) >= 8,
            f"simulation.height x width = {self.height} x {self.width}: an arm needs at least 8 x 8 pixels.",
        )
        _require(
            min(self.rest_frames, self.hold_frames, self.tail_frames) >= 1,
            f"simulation.rest_frames, hold_frames, tail_frames = {self.rest_frames}, {self.hold_frames}, "
            f"{self.tail_frames}: each must be at least 1.",
        )
        needed = self.rest_frames + 2 * self.hold_frames + self.tail_frames
        _require(
            self.n_frames > needed,
            f"simulation.n_frames = {self.n_frames} leaves no driven frames beside rest_frames = "
            f"{self.rest_frames}, two blends of hold_frames = {self.hold_frames} and tail_frames = "
            f"{self.tail_frames}: use more than {needed} frames or shorten these.",
        )
        _require(self.dt_s > 0, f"simulation.dt_s = {self.dt_s} s must be positive.")
        _require(
            0 < self.drive_low_hz < self.drive_high_hz < 0.5 / self.dt_s,
            f"simulation drive band {self.drive_low_hz}-{self.drive_high_hz} Hz must be increasing and lie "
            f"below half the frame rate ({0.5 / self.dt_s:.3g} Hz).",
        )
        _require(
            len(self.hold_atm) == 2 * len(self.arm.length),
            f"simulation.hold_atm has {len(self.hold_atm)} pressures for {len(self.arm.length)} segments: "
            "give two a segment.",
        )
        _require(
            all(0 <= pressure <= self.drive_max_atm for pressure in self.hold_atm),
            f"simulation.hold_atm = {self.hold_atm} must lie in 0..drive_max_atm = {self.drive_max_atm} atm.",
        )
        _require(
            min(self.pressure_noise_atm, self.camera_noise_levels) >= 0,
            f"simulation.pressure_noise_atm = {self.pressure_noise_atm} and camera_noise_levels = "
            f"{self.camera_noise_levels} are standard deviations and must not be negative.",
        )
        _require(self.view_width > 0, f"simulation.view_width = {self.view_width} m must be positive.")
        _require(
            self.rtol > 0 and self.atol > 0,
            f"simulation.rtol = {self.rtol} and atol = {self.atol} must be positive.",
        )
