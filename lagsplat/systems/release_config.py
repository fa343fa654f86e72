"""Values of a mechanism that is let go and filmed: its mechanics, its clips and its pictures. No torch."""

from dataclasses import dataclass


def _require(condition: bool, message: str) -> None:
    if not condition:
        raise ValueError(message)


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class LinkageConfig:
    """Hanging links, one value a link from the pivot on; see `lagsplat.systems.linkage.Linkage`."""

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
    """A body on a circular runner; see `lagsplat.systems.rocker.Rocker`."""

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
    """How a body looks: a shape of `lagsplat.systems.sprites.SHAPES`, its sizes and its thickness [m]."""

    shape: str
    size_m: list[float]
    thickness_m: float
    layers: int


@dataclass
class ClipConfig:
    """One take: its number of frames and the state it begins with [rad, rad/s]."""

    n_frames: int
    state: list[float]
    velocity: list[float]


@dataclass
class PushConfig:
    """A force on a body during one clip, a smooth pulse of ``force_n`` = (right, down) [N] at its height.

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
    """The place and the camera. The camera stands ``distance`` [m] from ``target``, (x, y) [m]."""

    background: str  # a photograph of scikit-image
    background_width: float  # of the photograph on the wall [m]
    behind: float  # from the plane of motion to the wall [m]
    target: list[float]
    distance: float
    yaw_deg: float
    pitch_deg: float
    view_width: float  # filled by the picture at the target [m]
    film_scale: int  # pixels of the film for one of the recording, along each axis
    noise_levels: float  # standard deviation of the camera, in levels of 255, on the film
    codec: str  # four letters of a codec OpenCV can write into the container
    container: str  # suffix of the film's file


@dataclass
class ReleaseConfig:
    """A stand-in: either a linkage or a rocker, its clips, forces, scene and film."""

    height: int
    width: int
    dt_s: float
    gravity: float
    rtol: float
    linkage: LinkageConfig | None
    rocker: RockerConfig | None
    bodies: list[BodyConfig]
    clips: list[ClipConfig]
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
