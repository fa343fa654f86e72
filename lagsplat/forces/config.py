"""Settings of forces given in the image; loads no torch, so that planning stays fast."""

from dataclasses import dataclass


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class ForcesConfig:
    """Size of the brush and the forces that figures and checks apply.

    Raises:
        ValueError: a value outside its domain.
    """

    brush: float  # radius of the brush as a share of the image's width
    response: float  # distance that the force of a figure moves the state, as a share of the visited radius
    points: int  # material points per body along each direction at which the truth is computed
    directions: int  # directions of the force at each point, evenly spaced
    levels: list[float]  # distances that the forces move the true state, as shares of the visited radius
    periods: float  # length of the response to a sudden force in slowest natural periods

    def __post_init__(self) -> None:
        """Check the domains."""
        for key in ("brush", "response"):
            _require(key, getattr(self, key), 0.0 < getattr(self, key) <= 1.0, "must lie in (0, 1]")
        for key, least in (("points", 2), ("directions", 2)):
            _require(key, getattr(self, key), getattr(self, key) >= least, f"must be at least {least}")
        _require("periods", self.periods, self.periods > 0, "must be positive")
        fine = len(self.levels) > 0 and min(self.levels) > 0 and self.levels == sorted(set(self.levels))
        _require("levels", self.levels, fine, "must be positive and increasing, at least one")


def _require(key: str, value: object, holds: bool, rule: str) -> None:
    if not holds:
        raise ValueError(f"forces.{key}={value} {rule}; set it in conf/forces or with forces.{key}=...")
