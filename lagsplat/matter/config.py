"""Settings of the motion of matter; loads no torch, so that planning stays fast."""

from dataclasses import dataclass

from lagsplat.setting_checks import require_least, require_setting


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class MatterConfig:
    """Which films are registered, and how richly a body may move."""

    frames: int  # most training frames that are registered
    latent_degree: int | None  # of the polynomials of the state; null: 3 for one coordinate, 2 for more
    bending: int  # highest degree in space of the field of a body that bends; 0: all bodies are rigid
    bodies: int  # most bodies

    def __post_init__(self) -> None:
        require_least(self, "matter", 20, "frames")
        require_least(self, "matter", 1, "bodies")
        require_least(self, "matter", 0, "bending")
        degree = self.latent_degree
        require_setting("matter.latent_degree", degree, degree is None or degree >= 1, "must be at least 1")
