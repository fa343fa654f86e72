"""What is believed of a parameter before a recording is looked at."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np

FARTHEST = 690.0
"""Largest logarithm whose exponential is neither zero nor infinite."""


@dataclass(frozen=True)
class Normal:
    """A priori normal about ``mean``; the unknown is the parameter itself."""

    deviation: float
    mean: float = 0.0
    lowest: float = -math.inf

    def value(self, x: Any) -> Any:
        """The parameter of unknown ``x``."""
        return x

    def unknown(self, value: float) -> float:
        """The unknown of a parameter."""
        return value

    def log_density(self, x: float) -> float:
        """Logarithm of the density of the unknown."""
        z = (x - self.mean) / self.deviation
        return -0.5 * z * z - math.log(self.deviation * math.sqrt(2.0 * math.pi))


@dataclass(frozen=True)
class HalfNormal(Normal):
    """A priori half-normal: never negative."""

    lowest: float = 0.0

    def log_density(self, x: float) -> float:
        """Logarithm of the density of the unknown."""
        return Normal.log_density(self, x) + math.log(2.0)


@dataclass(frozen=True)
class LogNormal(Normal):
    """A priori log-normal; the unknown is the logarithm. ``mean`` is that of the logarithm."""

    def value(self, x: Any) -> Any:
        """The parameter of unknown ``x``; never zero, since laws divide by it."""
        return np.exp(np.clip(x, -FARTHEST, FARTHEST))

    def unknown(self, value: float) -> float:
        """The unknown of a parameter."""
        return math.log(value)


def about(median: float, spread: float) -> LogNormal:
    """Log-normal with this median and this standard deviation of the logarithm."""
    return LogNormal(spread, math.log(median))
