"""Evidence for effects in recordings that have none: what a sim's own errors pass for.

A sim that was fitted is wrong in its own way wherever it goes. What effects gain on a recording of the very
mechanism it was fitted to, they gain by these errors, and on another recording they must gain more.
"""

from collections.abc import Callable, Sequence

from lagsplat.diagnose.catalogue import instances
from lagsplat.diagnose.config import DiagnoseConfig
from lagsplat.diagnose.hints import sought
from lagsplat.diagnose.select import Effort, rank
from lagsplat.diagnose.stand import Sim, stand
from lagsplat.io.motion import Motion
from lagsplat.io.motion_part import leading


def null_evidence(
    sim: Sim,
    own: Motion,
    real: Sequence[Motion],
    config: DiagnoseConfig,
    *,
    tell: Callable[[str], None] = lambda name: None,
) -> float:
    """Nats that the best effect gains on ``own``, a recording without effects, as long as ``real`` is.

    Evidence grows with the time recorded, so that a shorter one is scaled up. Zero where nothing gains.

    Raises:
        ValueError: ``own`` is too short for a single window.
    """
    wanted_s = sum(motion.duration_s for motion in real)
    null = [leading(own, wanted_s)]
    contest, _, natural = stand(sim, null, config)
    offers = instances(
        contest.bench,
        sought(sim.model, null, period_s=natural.longest_s, hold=config.input_hold),
        q_names=own.q_names,
        u_names=own.u_names,
        without=config.without,
    )
    effort = Effort.of(config, nominal=max(1.0, sim.misfit))
    found = rank(contest, offers, effort, tell=tell).found
    gained = max((one.log_evidence for one in found), default=0.0)
    return max(gained, 0.0) * max(1.0, wanted_s / null[0].duration_s)
