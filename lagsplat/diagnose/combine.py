"""A second and a third effect, where one leaves too much."""

from collections.abc import Sequence
from dataclasses import replace

from lagsplat.diagnose.catalogue import catalogue
from lagsplat.diagnose.compare import Contest, Explained, log_evidence
from lagsplat.diagnose.config import DiagnoseConfig
from lagsplat.diagnose.effects.effect import Instance, Noise
from lagsplat.diagnose.select import Effort, Ranking, Tell, rank
from lagsplat.diagnose.standing import leaders
from lagsplat.diagnose.verdict import moved

MOST = 3
FIRST = 3
"""Single effects that a second one is looked for beside."""
ENOUGH = 0.1
"""Excess of the mean square residual, in units of the noise, that is not worth explaining."""


def combine(
    contest: Contest,
    ranking: Ranking,
    offers: Sequence[Instance],
    effort: Effort,
    config: DiagnoseConfig,
    *,
    tell: Tell,
) -> tuple[Explained, ...]:
    """The best single effect, the best pair and the best triple, while there is something left to explain.

    The second is looked for beside each of the best few first ones, so that the first may turn out to be
    another (swap). Empty where nothing beats `none`.
    """
    singles = leaders(ranking, [name for name in catalogue() if name not in config.without], config)
    if not singles:
        return ()
    firsts = [one for one in singles if not isinstance(one.effects[-1].effect, Noise)]
    narrow = replace(effort, families=max(3, effort.families // 2), places=1, starts=1, always=())
    chain = [singles[0]]
    while len(chain) < MOST and (
        excess(chain[-1], contest, effort.nominal) > ENOUGH or moved(chain[-1], effort.nominal, config)
    ):
        beside = firsts[:FIRST] if len(chain) == 1 else chain[-1:]
        tried = []
        for held in beside:
            others = [o for o in offers if o.effect.name not in {e.effect.name for e in held.effects}]
            more = rank(contest, others, narrow, known=held, tell=tell)
            found = [one for one in more.found if not isinstance(one.effects[-1].effect, Noise)][:1]
            tried += [replace(one, log_evidence=held.log_evidence + one.log_evidence) for one in found]
        if not tried:
            break
        least = min(one.fit.misfit for one in tried) / contest.freedom
        temper = max(effort.nominal, least) * effort.temper
        best = max(tried, key=lambda one: log_evidence(one, contest.bench, temper))
        # of what stands above the noise, what the moved uncertainties cost included
        floor = effort.nominal * contest.freedom
        if best.fit.cost - floor > (1.0 - config.further) * (chain[-1].fit.cost - floor):
            break
        chain.append(best)
    return tuple(chain)


def excess(one: Explained, contest: Contest, nominal: float) -> float:
    """Mean square residual of a fit above what the sim leaves of its own recordings."""
    return one.fit.misfit / contest.freedom - nominal
