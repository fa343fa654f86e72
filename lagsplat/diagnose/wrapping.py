"""Angles that a sensor starts again from the other end of a turn."""

from dataclasses import replace

import numpy as np

from lagsplat.diagnose.finding import Finding
from lagsplat.io.motion import Motion

TURNS = (2.0 * np.pi, 360.0)


def unwrap(motion: Motion) -> tuple[Motion, tuple[Finding, ...]]:
    """The motion with angles continued where a sensor starts again from the other end of a turn.

    A step of a whole turn, in radians or degrees, to within a quarter of it counts, where no other step is a
    tenth as long; rates are not touched.
    """
    q, found = motion.q.copy(), []
    inside = motion.joined
    for i in range(motion.d):
        step = np.diff(q[:, i])
        for turn in TURNS:
            jumps = np.flatnonzero(inside & (np.abs(np.abs(step) - turn) < 0.25 * turn))
            others = np.delete(np.abs(step), jumps)
            span = np.ptp(q[:, i])
            if not jumps.size or span > 1.1 * turn or (others[np.delete(inside, jumps)] > 0.1 * turn).any():
                continue
            shift = np.zeros(motion.n)
            for start, stop in motion.segments:
                own = jumps[(jumps >= start) & (jumps < stop - 1)]
                for at in own:
                    shift[at + 1 : stop] -= turn * np.sign(step[at])
            q[:, i] += shift
            found.append(
                Finding(
                    "warn",
                    "wrapped",
                    motion.source,
                    f"{motion.q_names[i]} steps by a whole turn ({turn:.4g}) {len(jumps)} time(s)",
                    "an angle that starts again is no motion",
                    "it is continued here; record it unwrapped if that is wrong",
                    (motion.q_names[i],),
                )
            )
            break
    return replace(motion, q=q), tuple(found)
