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
class ViewsConfig:
    """Where pictures from other sides come from, and what they teach."""

    kind: str
    """``simulated``: the stand-in's own scene; ``rig``: calibrated cameras."""
    rig: str | None
    """For kind rig: the JSON that describes the cameras, see `lagsplat.views.rig`."""
    arrangement: ArrangementConfig | None
    """For kind simulated: where the cameras stand."""
    supervision: SupervisionConfig

    def __post_init__(self) -> None:
        """Check the kind and what it needs."""
        needs = {"simulated": ["arrangement"], "rig": ["rig"]}
        _require("kind", self.kind, self.kind in needs, f"is none of {', '.join(needs)}")
        for key in needs[self.kind]:
            _require(key, None, getattr(self, key) is not None, f"but kind {self.kind} needs it")


def _require(key: str, value: object, holds: bool, rule: str) -> None:
    if not holds:
        raise ValueError(f"views.{key}={value} {rule}; set it in conf/views or with views.{key}=...")
