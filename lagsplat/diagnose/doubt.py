"""What speaks against an explanation that leaves nothing unexplained: that it would explain anything."""

from dataclasses import dataclass
from typing import Literal

import numpy as np

from lagsplat.diagnose.compare import Contest, Explained
from lagsplat.diagnose.effects.effect import Noise
from lagsplat.diagnose.exogenous import repeated
from lagsplat.diagnose.loosened import rival
from lagsplat.diagnose.select import Ranking

UNSHOWN = 0.7
"""P(unknown) where nothing shows that what is named for an outer force comes from outside."""
SHAPELESS = ("external_push", "external_periodic_force", "hidden_mode", "creep")
"""Effects with times, frequencies or states of their own, of which two together fit most of anything."""
FITTING = 0.6
"""P(unknown) where two of these are needed."""
AHEAD, SCATTER = 0.0, 2.0
"""Nats ahead of the explanation at which a sim with loose parameters is as credible, and their scatter."""


@dataclass(frozen=True)
class Doubt:
    """P(unknown), at the least, for one reason.

    ``unrepeated``: an outer force in states that the record passes only with it. ``shapeless``: several
    effects that fit anything. ``loose``: the sim's own parameters, all moved, are more evident.
    """

    chance: float
    why: Literal["unrepeated", "shapeless", "loose"]


def doubt(contest: Contest, ranking: Ranking, one: Explained, *, nominal: float) -> Doubt:
    """The strongest doubt in ``one``, if it explains the gap; none in what only moves single samples."""
    if any(isinstance(instance.effect, Noise) for instance in one.effects):
        return Doubt(0.0, "loose")
    ahead = rival(contest, ranking.none, one, nominal=nominal, temper=ranking.temper)
    loose = 1.0 / (1.0 + np.exp(np.clip((AHEAD - ahead) / SCATTER, -50.0, 50.0)))
    shapes = sum(instance.effect.name in SHAPELESS for instance in one.effects)
    reasons = (
        Doubt(UNSHOWN * (1.0 - repeated(one, contest)), "unrepeated"),
        Doubt(FITTING if shapes > 1 else 0.0, "shapeless"),
        Doubt(float(loose), "loose"),
    )
    return max(reasons, key=lambda reason: reason.chance)
