"""Settings of novel views. Torch-free, so that planning stays fast."""

from dataclasses import dataclass


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class ArrangementConfig:
    """Cameras about the pivot, on a grid of yaws and pitches around the reference view, some held out."""

    yaw_deg: float  # largest yaw to either side
    pitch_deg: float  # largest pitch up and down
    columns: int
    rows: int
    held_out: int  # number of cameras between the others, used only for scores

    def __post_init__(self) -> None:
        """Check the domains."""
        for key in ("yaw_deg", "pitch_deg"):
            value = getattr(self, key)
            _require(key, value, 0 <= value < 90, "is an angle in [0, 90) degrees")
        for key in ("columns", "rows"):
            _require(key, getattr(self, key), getattr(self, key) >= 1, "must be at least 1")
        _require("held_out", self.held_out, self.held_out >= 0, "must not be negative")


@dataclass
class SupervisionConfig:
    """How novel views enter the training of stage 1."""

    weight: float  # weight of their photometric terms, relative to the recorded view's
    spread: float  # initial range of Gaussians in front of the pivot and behind it, as a share of its depth

    def __post_init__(self) -> None:
        """Check the domains."""
        _require("weight", self.weight, self.weight > 0, "must be positive; views=none trains without them")
        _require("spread", self.spread, 0 < self.spread < 1, "must lie in (0, 1)")


@dataclass
class SharpConfig:
    """The user's own installation of SHARP, and how its scenes become views.

    Its weights are for research only: not part of this project, nor downloaded by it.
    """

    command: str | None
    """Program and first words of the command line, such as `sharp`; null raises an error that asks for it."""
    checkpoint: str | None  # file of the weights; null raises an error that asks for it
    cache: str | None  # folder of the lifted frames and views; null puts them beside the recording's results
    focal_35mm: float  # 35 mm equivalent focal length of the camera, which makes depths metric
    upscale: int  # factor by which frames are enlarged before they are lifted
    keep_clouds: bool  # whether to keep the lifted frames, 66 MB each, once their views are drawn
    blur_px2: float  # variance added to drawn covariances; the network's own renders add none

    def __post_init__(self) -> None:
        """Check the domains."""
        _require("sharp.focal_35mm", self.focal_35mm, self.focal_35mm > 0, "must be positive [mm]")
        _require("sharp.upscale", self.upscale, self.upscale >= 1, "must be at least 1")
        _require("sharp.blur_px2", self.blur_px2, self.blur_px2 >= 0, "must not be negative")


@dataclass
class ViewsConfig:
    """Where novel views come from, and how they enter training."""

    kind: str  # `simulated`: the simulated scene; `rig`: calibrated cameras; `sharp`: estimated by a network
    rig: str | None  # for kind rig: the JSON file of the cameras, see `lagsplat.views.rig`
    sharp: SharpConfig | None  # for kind sharp: settings of the network
    arrangement: ArrangementConfig | None  # for the other two: the arrangement of the cameras
    supervision: SupervisionConfig

    def __post_init__(self) -> None:
        """Check the kind and what it needs."""
        needs = {"simulated": ["arrangement"], "rig": ["rig"], "sharp": ["sharp", "arrangement"]}
        _require("kind", self.kind, self.kind in needs, f"is none of {', '.join(needs)}")
        for key in needs[self.kind]:
            _require(key, None, getattr(self, key) is not None, f"but kind {self.kind} needs it")


def _require(key: str, value: object, holds: bool, rule: str) -> None:
    if not holds:
        raise ValueError(f"views.{key}={value} {rule}; set it in conf/views or with views.{key}=...")
