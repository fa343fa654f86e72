"""Settings of the simulated arm, of injected effects, and of mechanisms released from a pose. No torch."""

from dataclasses import dataclass


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise ValueError(message)


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class ArmConfig:
    """Mechanics of a planar hanging arm; every list holds one value per segment, base first.

    Lengths [m], masses [kg], rotary inertias [kg m^2]. ``bending_stiffness`` [N m/rad] acts on the bending
    angle of a segment, ``extension_stiffness`` [J] on its strain; a hardening ``h`` turns the restoring
    force ``k x`` into ``k x (1 + h x^2)``. Each damping coefficient is its stiffness times ``retardation_s``
    (Kelvin-Voigt). Behind a segment is a rigid link: the connector, or the tip cap. ``chamber_area`` [m^2],
    ``chamber_offset`` [m] from the backbone; ``chamber_limit`` is the ratio of the reinforcing fibre's
    length to the chamber's rest length: the bore narrows as the chamber stretches.
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
    ``pressure_noise_atm`` that of the logged pressures; the arm moves under the pressures without noise. The
    drive settles into ``hold_atm`` before all pressures are released.
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


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class PlantedConfig:
    """Effects injected into one recording and absent from the nominal arm; zeros change nothing.

    ``tip_mass`` [kg] is added to the tip cap; pressures reach the chambers by a first-order lag of
    ``actuator_lag_s`` [s]; each segment's bending has the friction torque that ``dry_friction`` [rad] of
    bending would balance.
    """

    tip_mass: float
    actuator_lag_s: float
    dry_friction: float

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if value < 0:
                raise ValueError(f"planted.{name} = {value}: give 0 for none, or a positive amount.")


@dataclass  # not frozen, for the same reason
class PlantsConfig:
    """Second recordings of an arm, ``n_frames`` each, driven by ``seed``; one for each of ``effects``.

    The key is the name under which a diagnosis should find the effect, or ``none``.
    """

    n_frames: int
    seed: int
    effects: dict[str, PlantedConfig]

    def __post_init__(self) -> None:
        if self.seed == 0:
            raise ValueError("planted.seed = 0 is the drive the sim was fitted to; choose another.")


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class LinkageConfig:
    """Hanging links, one value per link from the pivot on; see `lagsplat.systems.mechanism.Linkage`."""

    length: list[float]
    masses: list[float]
    center: list[float]
    inertia: list[float]
    friction: list[float]
    spring: list[float]

    def __post_init__(self) -> None:
        for name, values in vars(self).items():
            _require(
                len(values) == len(self.length) and min(values) >= 0,
                f"linkage.{name} = {values}: give one value, not negative, for each of the "
                f"{len(self.length)} links of linkage.length.",
            )


@dataclass
class RockerConfig:
    """A body on a circular runner; see `lagsplat.systems.mechanism.Rocker`."""

    radius: float
    depth: float
    body_mass: float
    inertia: float
    friction: float

    def __post_init__(self) -> None:
        _require(
            min(self.radius, self.depth, self.body_mass, self.inertia) > 0 and self.friction >= 0,
            f"rocker: {vars(self)}: all but the friction must be positive, or it does not come back.",
        )


@dataclass
class BodyConfig:
    """Appearance of a body: a shape of `systems.rendering.textures.SHAPES`, its sizes and thickness [m]."""

    shape: str
    size_m: list[float]
    thickness_m: float
    layers: int


@dataclass
class ReleaseClipConfig:
    """One clip: its number of frames and its initial state [rad, rad/s]."""

    n_frames: int
    state: list[float]
    velocity: list[float]


@dataclass
class PushConfig:
    """A force on a body during one clip, a smooth pulse with the peak ``force_n`` = (right, down) [N].

    It acts from ``start_s`` to ``stop_s`` of the clip at ``at_m``, a point in the body's own coordinates.
    """

    clip: int
    start_s: float
    stop_s: float
    body: int
    at_m: list[float]
    force_n: list[float]


@dataclass
class SceneConfig:
    """The background and the camera, which is ``distance`` [m] from ``target``, (x, y) [m]."""

    background: str  # a photograph of scikit-image
    background_width: float  # of the photograph on the wall [m]
    behind: float  # from the plane of motion to the wall [m]
    target: list[float]
    distance: float
    yaw_deg: float
    pitch_deg: float
    view_width: float  # of the image at the target [m]
    film_scale: int  # pixels of the video per pixel of the recording, along each axis
    noise_levels: float  # standard deviation of the camera, in levels of 255, in the video
    codec: str  # four letters of a codec OpenCV can write into the container
    container: str  # suffix of the video file


@dataclass
class ReleaseConfig:
    """A released mechanism: either a linkage or a rocker, with its clips, forces, scene and video."""

    height: int
    width: int
    dt_s: float
    gravity: float
    rtol: float
    linkage: LinkageConfig | None
    rocker: RockerConfig | None
    bodies: list[BodyConfig]
    clips: list[ReleaseClipConfig]
    pushes: list[PushConfig]
    scene: SceneConfig

    def __post_init__(self) -> None:
        _require(
            (self.linkage is None) != (self.rocker is None),
            "release: give either a linkage or a rocker, and null for the other.",
        )
        d = len(self.linkage.length) if self.linkage else 1
        _require(
            len(self.bodies) == d,
            f"release.bodies has {len(self.bodies)} for {d} moving part(s): give one look each.",
        )
        _require(len(self.clips) > 0, "release.clips is empty: there is nothing to film.")
        for clip in self.clips:
            _require(
                clip.n_frames >= 3 and len(clip.state) == len(clip.velocity) == d,
                f"release.clips: {vars(clip)}: at least 3 frames, and {d} values of state and velocity.",
            )
        for push in self.pushes:
            _require(
                0 <= push.clip < len(self.clips) and 0 <= push.body < d and push.start_s < push.stop_s,
                f"release.pushes: {vars(push)}: no such clip or body, or it ends before it begins.",
            )
        _require(
            min(self.dt_s, self.rtol, self.scene.distance, self.scene.view_width, self.gravity) > 0,
            "release: dt_s, rtol, gravity, scene.distance and scene.view_width must be positive.",
        )
        _require(
            min(self.height, self.width) >= 8 and self.scene.film_scale >= 1,
            f"release.height x width = {self.height} x {self.width}, film_scale {self.scene.film_scale}: at "
            "least 8 x 8 pixels and a scale of 1.",
        )
