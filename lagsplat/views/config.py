"""Settings of novel views. Torch-free, so that planning stays fast."""

from dataclasses import dataclass


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class ArrangementConfig:
    """Cameras about the pivot, on a grid of yaws and pitches around the reference view, and some held out."""

    yaw_deg: float
    """Largest turn to either side."""
    pitch_deg: float
    """Largest turn up and down."""
    columns: int
    rows: int
    held_out: int
    """Cameras between the others that score what training made of these."""

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
    """What novel views do to stage 1."""

    weight: float
    """Of their photometric terms, relative to those of the filmed view."""
    spread: float
    """Of the pivot's depth: how far in front of it and behind it Gaussians start."""

    def __post_init__(self) -> None:
        """Check the domains."""
        _require("weight", self.weight, self.weight > 0, "must be positive; views=none trains without them")
        _require("spread", self.spread, 0 < self.spread < 1, "must lie in (0, 1)")


@dataclass
class SharpConfig:
    """The user's own installation of SHARP, and how its scenes become views.

    Its weights may be used for research only: they are neither part of this project nor fetched by it.
    """

    command: str | None
    """Program and first words of the command line, such as `sharp`; null asks for it."""
    checkpoint: str | None
    """File of the weights; null asks for it."""
    cache: str | None
    """Folder of the lifted frames and views; null keeps them beside the recording's results."""
    focal_35mm: float
    """Focal length of the film's camera as for 35 mm film, by which depths are metric."""
    upscale: int
    """Frames are enlarged this many times before they are lifted."""
    keep_clouds: bool
    """Whether the lifted frames, 66 MB each, stay in the cache once their views are drawn."""
    blur_px2: float
    """Variance that is added to drawn covariances; the network's own renders add none."""

    def __post_init__(self) -> None:
        """Check the domains."""
        _require("sharp.focal_35mm", self.focal_35mm, self.focal_35mm > 0, "must be positive [mm]")
        _require("sharp.upscale", self.upscale, self.upscale >= 1, "must be at least 1")
        _require("sharp.blur_px2", self.blur_px2, self.blur_px2 >= 0, "must not be negative")


@dataclass
class ViewsConfig:
    """Where pictures from other sides come from, and what they teach."""

    kind: str
    """``simulated``: the stand-in's own scene; ``rig``: calibrated cameras; ``sharp``: a network's guess."""
    rig: str | None
    """For kind rig: the JSON that describes the cameras, see `lagsplat.views.rig`."""
    sharp: SharpConfig | None
    """For kind sharp: how the network is run."""
    arrangement: ArrangementConfig | None
    """For the other two: where the cameras stand."""
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
