"""Evidence for effects in recordings that have none: what a sim's own errors pass for.

A sim that was fitted is wrong in its own way wherever it goes. What effects gain on a recording of the very
mechanism it was fitted to, they gain by these errors, and on another recording they must gain more.
"""

from collections.abc import Callable, Sequence
from dataclasses import replace

from lagsplat.diagnose.catalogue import instances
from lagsplat.diagnose.compare import Contest
from lagsplat.diagnose.config import DiagnoseConfig
from lagsplat.diagnose.familiar import looks
from lagsplat.diagnose.hints import sought
from lagsplat.diagnose.prepare import rough_period_s
from lagsplat.diagnose.record import apart
from lagsplat.diagnose.select import Effort, rank
from lagsplat.diagnose.stand import Sim, periods, stand
from lagsplat.io.motion import Motion
from lagsplat.io.motion_part import leading

ELSEWHERE = 4.0
"""How much more the same errors may pass for in another recording than in the sim's own."""


def null_evidence(
    sim: Sim,
    own: Motion,
    real: Sequence[Motion],
    config: DiagnoseConfig,
    *,
    tell: Callable[[str], None] = lambda name: None,
) -> float:
    """Nats that an effect must gain beyond: `ELSEWHERE` times what the best gains where there is none.

    That is on ``own``, taken as long as ``real`` is. Evidence grows with the time recorded, so that a shorter
    one is scaled up. Where the sim knows how it was seen to move, those stretches of ``own`` are taken that
    are most like those of ``real``, each as often as it is called for. Zero where nothing gains.

    Raises:
        ValueError: ``own`` is too short for a single window.
    """
    wanted_s = sum(motion.duration_s for motion in real)
    part = leading(own, wanted_s)
    if sim.familiar is None:
        contest, more = stand(sim, [part], config)[0], max(1.0, wanted_s / part.duration_s)
        quiet = apart(contest.windows, contest.bench.record, sim.disturbed)
        contest = replace(contest, windows=quiet)
    else:
        contest, more = like(sim, own, real, config), 1.0
    natural = periods(sim.model, rough_period_s([part]))
    offers = instances(
        contest.bench,
        sought(sim.model, [part], period_s=natural.longest_s, hold=config.input_hold),
        q_names=own.q_names,
        u_names=own.u_names,
        without=config.without,
    )
    effort = Effort.of(config, nominal=max(1.0, sim.misfit))
    found = rank(contest, offers, effort, tell=tell).found
    gained = max((one.log_evidence for one in found), default=0.0)
    return ELSEWHERE * max(gained, 0.0) * more


def like(sim: Sim, own: Motion, real: Sequence[Motion], config: DiagnoseConfig) -> Contest:
    """The contest on stretches of the sim's ``own`` motion, one for each of ``real`` and most like it.

    A law has its errors where it has them: a recording that mostly swings freely meets other ones than the
    sim's own, which hardly does.
    """
    assert sim.familiar is not None
    there, ready, _ = stand(sim, real, config)
    here, own_ready, _ = stand(sim, [own], config)
    chosen = sim.familiar.nearest(
        looks(there.windows, ready.smooth, ready.record),
        looks(here.windows, own_ready.smooth, own_ready.record),
    )
    return replace(here, windows=here.windows.only(chosen))
