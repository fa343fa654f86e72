"""Settings of the simulated arm, of injected effects, and of mechanisms released from a pose. No torch.

Dataclasses are not frozen: OmegaConf turns frozen ones into read-only nodes.
"""

from dataclasses import dataclass

from lagsplat.setting_checks import require_least, require_positive, require_setting


@dataclass
class ArmConfig:
    """Mechanics of a planar hanging arm; every list holds one value per segment, base first.

    Lengths [m], masses [kg]. A hardening ``h`` turns the restoring force ``k x`` into ``k x (1 + h x^2)``.
    """

    length: list[float]
    half_width: float
    mass: list[float]
    bending_stiffness: list[float]  # on the bending angle of a segment [N m/rad]
    bending_hardening: float
    extension_stiffness: list[float]  # on its strain [J]
    extension_hardening: float
    retardation_s: float  # each damping coefficient over its stiffness (Kelvin-Voigt) [s]
    chamber_area: list[float]  # [m^2]
    chamber_offset: float  # from the backbone
    chamber_limit: float  # length of the reinforcing fibre over the rest length: stretching narrows the bore
    link_length: list[float]  # of the rigid link behind a segment: the connector, or the tip cap
    link_mass: list[float]
    gravity: float

    def __post_init__(self) -> None:
        n, rule = len(self.length), "needs a value for each of the {} segments (arm.length), base first"
        positive = ("length", "mass", "bending_stiffness", "extension_stiffness", "chamber_area")
        for name in (*positive, "link_length", "link_mass"):
            values = getattr(self, name)
            require_setting(f"simulation.arm.{name}", values, len(values) == n, rule.format(n))
            enough = name not in positive or min(values) > 0
            require_setting(f"simulation.arm.{name}", values, enough, "must be positive")
        require_positive(self, "simulation.arm", "half_width")
        rule = "must exceed sqrt(3) = 1.732: below it a pressurised chamber shortens instead of lengthening"
        require_setting("simulation.arm.chamber_limit", self.chamber_limit, self.chamber_limit > 3**0.5, rule)
        gains = ("bending_hardening", "extension_hardening", "retardation_s")
        require_least(self, "simulation.arm", 0, *gains)  # else the arm softens without bound or gains energy


@dataclass
class SimulationConfig:
    """A recording to simulate. Counts in frames, ``dt_s`` [s], pressures [atm], ``view_width`` [m]."""

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
    hold_atm: list[float]  # into which the drive settles before all pressures are released
    pressure_noise_atm: float  # standard deviation of the logged pressures; the arm moves without this noise
    camera_noise_levels: float  # standard deviation of the camera, in grey levels of 255
    rtol: float
    atol: float
    arm: ArmConfig

    def __post_init__(self) -> None:
        require_least(self, "simulation", 8, "height", "width")
        require_least(self, "simulation", 1, "rest_frames", "hold_frames", "tail_frames")
        needed = self.rest_frames + 2 * self.hold_frames + self.tail_frames
        rule = f"must exceed rest_frames + 2 hold_frames + tail_frames = {needed}, to leave driven frames"
        require_setting("simulation.n_frames", self.n_frames, self.n_frames > needed, rule)
        require_positive(self, "simulation", "dt_s", "drive_low_hz", "view_width", "rtol", "atol")
        low, half_rate = self.drive_low_hz, 0.5 / self.dt_s
        rule = f"must lie between drive_low_hz={low} and half the frame rate ({half_rate:.3g} Hz)"
        between = low < self.drive_high_hz < half_rate
        require_setting("simulation.drive_high_hz", self.drive_high_hz, between, rule)
        rule = f"has not two pressures for each of {len(self.arm.length)} segments"
        two_each = len(self.hold_atm) == 2 * len(self.arm.length)
        require_setting("simulation.hold_atm", self.hold_atm, two_each, rule)
        within = all(0 <= pressure <= self.drive_max_atm for pressure in self.hold_atm)
        rule = f"must lie in 0..drive_max_atm={self.drive_max_atm} atm"
        require_setting("simulation.hold_atm", self.hold_atm, within, rule)
        require_least(self, "simulation", 0, "pressure_noise_atm", "camera_noise_levels")


@dataclass
class PlantedEffectConfig:
    """Effects injected into one recording and absent from the nominal arm; zeros change nothing."""

    tip_mass: float  # added to the tip cap [kg]
    actuator_lag_s: float  # time constant of the first-order lag of the chambers' pressures [s]
    dry_friction: float  # bending that would balance the friction torque of each segment's bending [rad]

    def __post_init__(self) -> None:
        require_least(self, "planted.effects.NAME", 0, *vars(self))


@dataclass
class PlantedRecordingsConfig:
    """Second recordings of an arm, ``n_frames`` each, driven by ``seed``; one for each of ``effects``.

    The key is the name under which a diagnosis should find the effect, or ``none``.
    """

    n_frames: int
    seed: int
    effects: dict[str, PlantedEffectConfig]

    def __post_init__(self) -> None:
        rule = "is the drive that the simulation was fitted to: choose another"
        require_setting("planted.seed", self.seed, self.seed != 0, rule)


@dataclass
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
            each = len(values) == len(self.length) and min(values) >= 0
            rule = f"needs one value, not negative, for each of the {len(self.length)} links"
            require_setting(f"release.linkage.{name}", values, each, rule)


@dataclass
class RockerConfig:
    """A body on a circular runner; see `lagsplat.systems.mechanism.Rocker`."""

    radius: float
    depth: float
    body_mass: float
    inertia: float
    friction: float

    def __post_init__(self) -> None:
        require_positive(self, "release.rocker", "radius", "depth", "body_mass", "inertia")
        require_least(self, "release.rocker", 0, "friction")


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
    """A force on a body during one clip, a smooth pulse."""

    clip: int
    start_s: float  # from the start of the clip, as `stop_s`
    stop_s: float
    body: int
    at_m: list[float]  # where it acts, a point in the body's own coordinates
    force_n: list[float]  # its peak, to the right and down [N]


@dataclass
class SceneConfig:
    """The background and the camera, which is ``distance`` [m] from ``target``, (x, y) [m]."""

    background: str  # a wall of `systems.rendering.workshop.WALLS`
    background_width: float  # of that wall [m]
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
        if (self.linkage is None) == (self.rocker is None):
            raise ValueError("release: give either a linkage or a rocker, and null for the other")
        d = len(self.linkage.length) if self.linkage else 1
        rule = f"needs one look for each of the {d} moving part(s)"
        require_setting("release.bodies", self.bodies, len(self.bodies) == d, rule)
        rule = "is empty: there is nothing to record"
        require_setting("release.clips", self.clips, len(self.clips) > 0, rule)
        for clip in self.clips:
            whole = clip.n_frames >= 3 and len(clip.state) == len(clip.velocity) == d
            rule = f"needs at least 3 frames, and {d} values of state and velocity"
            require_setting("release.clips", vars(clip), whole, rule)
        for push in self.pushes:
            exists = 0 <= push.clip < len(self.clips) and 0 <= push.body < d and push.start_s < push.stop_s
            rule = "names no such clip or body, or ends before it begins"
            require_setting("release.pushes", vars(push), exists, rule)
        require_positive(self, "release", "dt_s", "rtol", "gravity")
        require_positive(self.scene, "release.scene", "distance", "view_width")
        require_least(self, "release", 8, "height", "width")
        require_least(self.scene, "release.scene", 1, "film_scale")
