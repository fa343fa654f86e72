"""A sim whose parameters are all somewhat wrong, as the rival of every effect.

What moves several of the mechanism's own parameters at once can be imitated by an effect with enough freedom.
Where the sim explains as much with its parameters let loose, and is far more evident so, the effect is not
the cause.
"""

from dataclasses import replace

import numpy as np

from lagsplat.diagnose.compare import Contest, Explained, log_evidence

LOOSE = 60.0
"""How much looser: what is known to parts in a thousand may then be off by tens of per cent."""
BELIEVED = 1.5
"""Mean square residual on its own recordings, in that of the noise, up to which a sim can be believed."""
WORSE = 0.05
"""Mean square residual, in that of the noise, by which the loose sim may be worse and still explain all."""


def rival(contest: Contest, none: Explained, best: Explained, *, nominal: float, temper: float) -> float:
    """Nats by which the loosened sim is more evident than ``best``; minus infinity if it explains less.

    So it is where the sim misses even its own recordings: then to explain the rest is no achievement.
    """
    if nominal > BELIEVED:
        return -np.inf
    bench = contest.bench
    loose = replace(contest, bench=replace(bench, nuisance=bench.nuisance.loosened(LOOSE)))
    fit = loose.fit((), none.fit.x, none.fit.starts)
    noise = nominal * contest.freedom
    if fit.misfit > max(best.fit.misfit, noise) + WORSE * noise:
        return -np.inf
    there = log_evidence(Explained((), fit), loose.bench, temper)
    return there - log_evidence(best, bench, temper)
