"""A second and a third effect, where one leaves too much."""

from collections.abc import Sequence
from dataclasses import replace

from lagsplat.diagnose.compare import Contest, Explained, log_evidence
from lagsplat.diagnose.config import DiagnoseConfig
from lagsplat.diagnose.effects.effect import Instance, Noise
from lagsplat.diagnose.select import Effort, Ranking, Tell, rank

MOST = 3
FIRST = 3
"""Single effects that a second one is looked for beside."""


def combine(
    contest: Contest,
    ranking: Ranking,
    offers: Sequence[Instance],
    effort: Effort,
    config: DiagnoseConfig,
    *,
    tell: Tell,
) -> Explained | None:
    """The best set of effects, or None where nothing beats `none`.

    Another effect is added only if it takes away the share ``config.further`` of what the last left above
    the noise; beside each of the best few first ones, so that the first may turn out to be another (swap).
    """
    singles = [one for one in ranking.found if one.log_evidence > 0.0]
    if not singles:
        return None
    best = singles[0]
    firsts: list[Explained] = []
    for one in singles:
        if isinstance(one.effects[-1].effect, Noise):
            continue
        if all(one.effects[-1].effect.name != other.effects[-1].effect.name for other in firsts):
            firsts.append(one)
    narrow = replace(effort, families=max(3, effort.families // 2), places=1, starts=1, always=())
    excess = max(ranking.none.fit.misfit / contest.freedom - effort.nominal, 1e-9)
    for size in range(2, MOST + 1):
        left = best.fit.misfit / contest.freedom - effort.nominal
        if left < 0.15 or left < 0.02 * excess:
            break
        tried = []
        for first in firsts[: FIRST if size == 2 else 1]:
            held = first if size == 2 else best
            others = [o for o in offers if o.effect.name not in {e.effect.name for e in held.effects}]
            more = rank(contest, others, narrow, known=held, tell=tell)
            tried += [one for one in more.found if not isinstance(one.effects[-1].effect, Noise)][:1]
        if not tried:
            break
        pair = min(tried, key=lambda one: one.fit.misfit + one.fit.penalty)
        if pair.fit.misfit / contest.freedom - effort.nominal > (1.0 - config.further) * left:
            break
        best = pair
    temper = max(effort.nominal, best.fit.misfit / contest.freedom) * effort.temper
    floor = log_evidence(ranking.none, contest.bench, temper)
    if len(best.effects) > 1:
        best = replace(best, log_evidence=log_evidence(best, contest.bench, temper) - floor)
    return best
