"""What the report of any diagnosis shows beside its verdict: the ladder, and how much the recording tells."""

import contextlib
from collections.abc import Sequence
from typing import TYPE_CHECKING

import numpy as np

from lagsplat.diagnose.diagnose import Found
from lagsplat.diagnose.fingerprint import fingerprint
from lagsplat.diagnose.ladder import Rung, climb
from lagsplat.diagnose.profile import profiles
from lagsplat.diagnose.separability import separability
from lagsplat.diagnose.smoother import smooth
from lagsplat.io.motion import Motion
from lagsplat.io.motion_part import leading
from lagsplat.report.diagnosis_exhibits import Exhibits

if TYPE_CHECKING:
    from lagsplat.pair import Pair

CLIMBED = 40  # natural periods of the sim's own motions by which the floors of the ladder are told


def shown(pair: "Pair", found: Found) -> Exhibits:
    """The ladder, what the residual goes with, what is told apart, how sharply numbers are known."""
    temper, real = found.ranking.temper, pair.real[0]
    where = found.diagnosis.where
    return Exhibits(
        rungs=rungs(pair, found),
        fingerprint=where and fingerprint(where.smoothed, q_names=real.q_names, u_names=real.u_names),
        separability=separability(found.contest, found.ranking.found, temper=temper),
        profiles=tuple(profiles(found.contest, found.chosen, temper=temper)),
    )


def rungs(pair: "Pair", found: Found) -> tuple[Rung, ...]:
    """The ladder; floors are those of the sim's own motions, of its training part if it is a fitted run.

    None where the residual could not be worked out.
    """
    if found.diagnosis.where is None:
        return ()
    checked, period_s = pair.checked.sim, float(found.diagnosis.checks["natural_period_s"])
    nominal = None
    if checked is not None:
        part = _leading(checked.motions, CLIMBED * period_s)
        hold = "zoh" if found.contest.bench.held else "linear"
        with contextlib.suppress(np.linalg.LinAlgError):  # a sim that cannot follow even its own motions
            nominal = smooth(pair.sim.model, part, period_s=period_s, hold=hold)
    sight = None if pair.films is None else pair.films.sight
    return climb(
        pair.sim.model,
        found.diagnosis.where.smoothed,
        nominal,
        horizon_s=period_s,
        pictures=None if sight is None else (sight.error_real, sight.error_nominal),
        block=10,
    )


def _leading(motions: Sequence[Motion], length_s: float) -> list[Motion]:
    """The first of all motions, as much as lasts ``length_s`` together."""
    kept: list[Motion] = []
    for motion in motions:
        if length_s > 0.0:
            kept.append(leading(motion, length_s))
            length_s -= kept[-1].duration_s
    return kept
