"""Instants of the frames that are only known roughly: noise that grows with the speed."""

from typing import Any

from lagsplat.diagnose.effects.effect import HalfNormal, Noise, Parameter


def variance(v: Any, theta: float) -> Any:
    """``(std v)^2``."""
    return (theta * v) ** 2


EFFECT = Noise(
    name="time_jitter",
    group="G",
    equation="y = q(t + e), e of standard deviation std",
    parameters=(Parameter("std", "frame", HalfNormal(0.5)),),
    needs="fast and slow stretches",
    along="whole",
    variance=variance,
)
