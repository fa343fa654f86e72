"""Settings of the free neural differential equation. Torch-free: planning stays fast."""

from dataclasses import dataclass


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class OdeConfig:
    """Everything that decides a free neural differential equation, less the chart and the seed.

    Raises:
        ValueError: a value outside its domain.
    """

    hidden: int
    layers: int  # hidden ones
    method: str  # of torchdiffeq, one step a frame: 'rk4' or 'midpoint'
    steps: int
    batch: int  # windows a step
    periods: float  # length of a window in natural periods; it grows to this from a quarter
    rate: float  # Adam
    final_fraction: float  # of the rate, reached at the last step on a cosine
    gradient_clip: float
    checkpoint_every_s: float

    def __post_init__(self) -> None:
        """Check the domains."""
        for name in ("hidden", "layers", "steps", "batch"):
            _require(name, getattr(self, name), getattr(self, name) >= 1, "must be at least 1")
        for name in ("periods", "rate", "gradient_clip"):
            _require(name, getattr(self, name), getattr(self, name) > 0, "must be positive")
        _require("method", self.method, self.method in ("rk4", "midpoint"), "must be rk4 or midpoint")
        share = 0 < self.final_fraction <= 1
        _require("final_fraction", self.final_fraction, share, "must lie in (0, 1]")


def _require(key: str, value: object, holds: bool, rule: str) -> None:
    if not holds:
        raise ValueError(f"ode.{key}={value} {rule}; set it in conf/ode or with ode.{key}=...")
