"""What a recording can show: how large an effect must be to show.

The score test tells, before any effect is fitted, what log evidence one of the expected size would have,
beside all that the simulator leaves open. Evidence grows with the square of the size.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from math import sqrt

from lagsplat.diagnose.core.config import EXCITATION
from lagsplat.diagnose.effects.base import Effect, SampleEffect


@dataclass(frozen=True)
class Excitation:
    """Whether a recording shows one effect."""

    effect: str
    excited: str  # `yes` where one of the expected size shows, `weak` or `no`
    smallest: float | None
    """The size that shows over the expected one, its prior's standard deviation [1]; None if none does."""
    record: str  # what to record instead; empty where the effect is excited


def grade_excitation(information: Mapping[str, float], effects: Iterable[Effect]) -> tuple[Excitation, ...]:
    """Grade a recording for effects but those on single samples, which every recording shows alike.

    ``information`` is the log evidence that one of the expected size would have [nat], by name.
    """
    rows = []
    for effect in effects:
        if not isinstance(effect, SampleEffect):
            nats = information.get(effect.name, 0.0)
            excited = "yes" if nats >= EXCITATION.strong else "weak" if nats >= EXCITATION.positive else "no"
            smallest = sqrt(EXCITATION.strong / nats) if nats > 0.0 else None
            rows.append(Excitation(effect.name, excited, smallest, "" if excited == "yes" else effect.needs))
    return tuple(rows)
