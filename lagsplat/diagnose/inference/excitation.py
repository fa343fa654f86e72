"""What a recording can show: the log evidence that an effect of the size expected of it would have.

Measured by the score test, before any effect is fitted, beside all that the simulator leaves open.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass

from lagsplat.diagnose.core.config import EXCITATION
from lagsplat.diagnose.effects.base import Effect, SampleEffect


@dataclass(frozen=True)
class Excitation:
    """Whether a recording shows one effect."""

    effect: str
    excited: str  # `yes`, `weak` or `no`
    nats: float  # log evidence of one as large as its prior's standard deviation; 0 where it has no place
    record: str  # what to record instead; empty where the effect is excited


def grade_excitation(information: Mapping[str, float], effects: Iterable[Effect]) -> tuple[Excitation, ...]:
    """Grade a recording for effects but those on single samples, which every recording shows alike.

    ``information`` is the log evidence that each would have [nat], by name.
    """
    rows = []
    for effect in effects:
        if not isinstance(effect, SampleEffect):
            nats = information.get(effect.name, 0.0)
            excited = "yes" if nats >= EXCITATION.strong else "weak" if nats >= EXCITATION.positive else "no"
            record = "" if excited == "yes" else effect.needs
            rows.append(Excitation(effect.name, excited, nats, record))
    return tuple(rows)
