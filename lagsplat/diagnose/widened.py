"""A recording that nothing tells to within its noise, held against every hypothesis once more.

Where the best explanation misses by many times the noise, laws are wrong in ways of their own, for long
stretches at once. Taken for white noise, samples so precise and so many would outweigh whatever is believed
of the sim: its own parameters would move by hundreds of standard deviations to make up for the gap, and
`none` would look good. What is left counts as the noise, therefore, and samples that agree in it as one.
"""

from dataclasses import replace

import numpy as np

from lagsplat.diagnose.compare import Contest, Explained
from lagsplat.diagnose.select import Effort
from lagsplat.diagnose.stand import correlation

FAR = 4.0
"""Mean square residual, in multiples of what the sim leaves of its own recordings, that asks for it."""


def widened(contest: Contest, effort: Effort, best: Explained) -> tuple[Contest, Effort] | None:
    """The contest at the price of what the ``best`` explanation leaves; None if that is near the noise.

    What it leaves is that of the middle window: a push by hand in a few of them says nothing of the law.
    """
    each = [(row[:n] ** 2).mean() for row, n in zip(best.fit.residual, contest.windows.length, strict=True)]
    left = min(best.fit.misfit / contest.freedom, float(np.median(each)))
    if left <= FAR * effort.nominal:
        return None
    alike = correlation(best.fit.residual, contest.windows.length)
    price = max(contest.price, left * alike)
    return replace(contest, price=price), replace(effort, temper=max(effort.temper, alike))
