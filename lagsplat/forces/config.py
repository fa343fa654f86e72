"""Settings of forces given in the image; loads no torch, so that planning stays fast."""

from dataclasses import dataclass

from lagsplat.setting_checks import require_least, require_positive, require_setting


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class ForcesConfig:
    """Size of the brush and the forces that figures and checks apply."""

    brush: float  # radius of the brush as a share of the image's width
    response: float  # distance that the force of a figure moves the state, as a share of the visited radius
    points: int  # material points per body along each direction at which the truth is computed
    directions: int  # directions of the force at each point, evenly spaced
    levels: list[float]  # distances that the forces move the true state, as shares of the visited radius
    periods: float  # length of the response to a sudden force in slowest natural periods
    laws: int  # most laws that the recording allows as well, by which the spread of an answer is told

    def __post_init__(self) -> None:
        for key in ("brush", "response"):
            value = getattr(self, key)
            require_setting(f"forces.{key}", value, 0.0 < value <= 1.0, "must lie in (0, 1]")
        require_least(self, "forces", 2, "points", "directions")
        require_least(self, "forces", 1, "laws")
        require_positive(self, "forces", "periods")
        fine = len(self.levels) > 0 and min(self.levels) > 0 and self.levels == sorted(set(self.levels))
        require_setting("forces.levels", self.levels, fine, "must be positive and increasing, at least one")
