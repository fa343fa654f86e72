"""How hypotheses stand to one another once priors are counted and laws are taken for what they are."""

import numpy as np

from lagsplat.diagnose.compare import Explained
from lagsplat.diagnose.config import DiagnoseConfig
from lagsplat.diagnose.select import Ranking

ROUGHLY = 200.0
RARER = {
    "camera_change": 4.0,
    "external_push": 3.0,
    "hidden_mode": 3.0,
    "stribeck_friction": 2.0,
    "load_dependent_friction": 2.0,
}
"""Nats by which a flexible effect is held less likely beforehand, for it imitates many others."""
SLOW, A_SPRING = 0.5, 4.0
"""Share of the recording from which creep takes so long that it is but a spring, and nats that this costs."""


def trust(ranking: Ranking) -> float:
    """What a nat is worth: the laws of the catalogue are never quite those of nature.

    Where thousands of nats stand between `none` and the best, a per cent of them between two effects may be
    the fault of a law, so that no more than `ROUGHLY` nats count in all.
    """
    most = max((one.log_evidence for one in ranking.found), default=0.0)
    return 1.0 / (1.0 + max(most, 0.0) / ROUGHLY)


def standings(ranking: Ranking, names: list[str], config: DiagnoseConfig) -> dict[str, float]:
    """Log posterior, up to a constant, of `none` and of every effect that was fitted, at its best place.

    Each of the ``names`` of the catalogue is as likely beforehand, whatever the number of its places.
    """
    prior = np.log((1.0 - config.prior_none - config.prior_unknown) / len(names))
    scores = {"none": float(np.log(config.prior_none))}
    places: dict[str, int] = {}
    worth = trust(ranking)
    for one in ranking.found:
        name = one.effects[-1].effect.name
        places[name] = places.get(name, 0) + 1
        rare = RARER.get(name, 0.0) + (A_SPRING if name == "creep" and _hardly_creeps(one) else 0.0)
        scores.setdefault(name, float(prior) + worth * one.log_evidence - rare)
    for name, n in places.items():
        scores[name] -= float(np.log(n))
    return scores


def _hardly_creeps(one: Explained) -> bool:
    """Whether its time constant is about as long as the recording: nobody saw it come to rest."""
    instance = one.effects[-1]
    own = instance.physical(one.fit.x[None, one.own(instance)])[0]
    keys = [p.name for p in instance.effect.parameters]
    return bool(own[keys.index("time_constant")] > SLOW * instance.scales.duration_s)


def leaders(ranking: Ranking, names: list[str], config: DiagnoseConfig) -> list[Explained]:
    """The best fit of every effect that stands above `none`, the best first."""
    scores = standings(ranking, names, config)
    best: dict[str, Explained] = {}
    for one in ranking.found:
        best.setdefault(one.effects[-1].effect.name, one)
    above = [name for name in best if scores[name] > scores["none"]]
    return [best[name] for name in sorted(above, key=lambda name: -scores[name])]
