"""Inputs that never move: nothing can be said of what they would do."""

from collections.abc import Sequence

import numpy as np

from lagsplat.diagnose.finding import Finding
from lagsplat.io.motion import Motion

STILL = 1e-6  # of an input's size: what a constant may wander by


def check_inputs(sim: Sequence[Motion], real: Sequence[Motion]) -> list[Finding]:
    """Inputs that are constant on the real side, and those that only the real side ever moved.

    The second leave the verdict undetermined: a sim that never saw an input move does not know what it does.
    """
    if not real:
        return []
    found = []
    shared = [name for name in real[0].u_names if not sim or name in sim[0].u_names]
    for name in shared:
        moves_real, moves_sim = _moves(real, name), not sim or _moves(sim, name)
        if not moves_real:
            found.append(
                Finding(
                    "warn",
                    "constant input",
                    "real",
                    f"{name} is constant",
                    "lag, delay, dead zone, saturation, play and gain of it cannot be seen",
                    "move it through zero, slowly and fast, if such effects are in question",
                    (name,),
                )
            )
        elif not moves_sim:
            found.append(
                Finding(
                    "undetermined",
                    "input of one side",
                    "real",
                    f"{name} moves, and is constant in the sim",
                    "the sim does not tell what this input does, which would pass for an effect",
                    "record the sim with this input moving",
                    (name,),
                )
            )
    return found


def _moves(motions: Sequence[Motion], name: str) -> bool:
    values = np.concatenate([motion.u[:, motion.u_names.index(name)] for motion in motions])
    return bool(np.ptp(values) > STILL * np.abs(values).max())
