"""Settings of novel views. Torch-free, so that planning stays fast."""

from dataclasses import dataclass

from lagsplat.setting_checks import require_least, require_positive, require_setting


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class ArrangementConfig:
    """Cameras about the pivot, on a grid of yaws and pitches around the reference view, some held out."""

    yaw_deg: float  # largest yaw to either side
    pitch_deg: float  # largest pitch up and down
    columns: int
    rows: int
    held_out: int  # number of cameras between the others, used only for scores

    def __post_init__(self) -> None:
        rule = "is an angle in [0, 90) degrees"
        for key in ("yaw_deg", "pitch_deg"):
            value = getattr(self, key)
            require_setting(f"views.arrangement.{key}", value, 0 <= value < 90, rule)
        require_least(self, "views.arrangement", 1, "columns", "rows")
        require_least(self, "views.arrangement", 0, "held_out")


@dataclass
class SupervisionConfig:
    """How novel views enter the training of stage 1."""

    weight: float  # weight of their photometric terms, relative to the recorded view's
    spread: float  # initial range of Gaussians in front of the pivot and behind it, as a share of its depth

    def __post_init__(self) -> None:
        rule = "must be positive; views=none trains without them"
        require_setting("views.supervision.weight", self.weight, self.weight > 0, rule)
        require_setting("views.supervision.spread", self.spread, 0 < self.spread < 1, "must lie in (0, 1)")


@dataclass
class SharpConfig:
    """The user's own installation of SHARP, and how its scenes become views.

    Its weights are for research only: not part of this project, nor downloaded by it.
    """

    command: str | None  # program and first words of the command line, such as `sharp`; null asks for it
    checkpoint: str | None  # file of the weights; null asks for it
    cache: str | None  # folder of the lifted frames and views; null puts them beside the recording's results
    focal_35mm: float  # 35 mm equivalent focal length of the camera, which makes depths metric
    upscale: int  # factor by which frames are enlarged before they are lifted
    keep_clouds: bool  # whether to keep the lifted frames, 66 MB each, once their views are drawn
    blur_px2: float  # variance added to drawn covariances; the network's own renders add none

    def __post_init__(self) -> None:
        require_positive(self, "views.sharp", "focal_35mm")
        require_least(self, "views.sharp", 1, "upscale")
        require_least(self, "views.sharp", 0, "blur_px2")


@dataclass
class ViewsConfig:
    """Where novel views come from, and how they enter training."""

    kind: str  # `simulated`: the simulated scene; `rig`: calibrated cameras; `sharp`: estimated by a network
    rig: str | None  # for kind rig: the JSON file of the cameras, see `lagsplat.views.rig`
    sharp: SharpConfig | None  # for kind sharp: settings of the network
    arrangement: ArrangementConfig | None  # for the other two: the arrangement of the cameras
    supervision: SupervisionConfig

    def __post_init__(self) -> None:
        needs = {"simulated": ["arrangement"], "rig": ["rig"], "sharp": ["sharp", "arrangement"]}
        require_setting("views.kind", self.kind, self.kind in needs, f"is none of {', '.join(needs)}")
        for key in needs[self.kind]:
            given = getattr(self, key) is not None
            require_setting(f"views.{key}", None, given, f"but kind {self.kind} needs it")
