"""Recordings far finer than their motion, averaged: a log at 1 kHz of a swing of one second, say.

Time is spent on every sample, and a thousand of them a period tell no more than a hundred means of ten.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from lagsplat.diagnose.finding import Finding
from lagsplat.diagnose.prepare import rms_period_s
from lagsplat.io.motion import Motion

ENOUGH = 100.0
"""Samples that are kept, at least, of the rms period of the rates."""
CAMERA_HZ = 120.0
"""As many a second are left in any case: at such rates frames that are lost, or come late, are looked for."""


def thinned(motions: Sequence[Motion], *, hold: str) -> tuple[tuple[Motion, ...], tuple[Finding, ...]]:
    """The motions as means of so many neighbours that a period keeps `ENOUGH`, and what was done.

    ``hold`` says how inputs act between samples: ``zoh`` or ``linear``.
    """
    period_s = rms_period_s(motions, 1)
    out, told = [], []
    for motion in motions:
        many = (period_s or 0.0) / (ENOUGH * motion.dt_s)
        many = min(many, 1.0 / (CAMERA_HZ * motion.dt_s))
        n = 2 * int((many - 1.0) / 2.0) + 1 if many > 1.0 else 1
        shorter = averaged(motion, n, held=hold == "zoh") if n > 1 else motion
        out.append(shorter)
        if shorter is not motion:
            told.append(
                Finding(
                    "note",
                    "averaged",
                    motion.source,
                    f"{1.0 / motion.dt_s:.3g} samples a second are far more than the motion needs, so that "
                    f"means of {n} are looked at, {1.0 / shorter.dt_s:.3g} a second",
                    "what happens within so short a time, as a sample that comes late, is not seen",
                    "cut out and give a short stretch, if that is what is sought",
                )
            )
    return tuple(out), tuple(told)


def averaged(motion: Motion, n: int, *, held: bool) -> Motion:
    """Means of ``n`` samples, an odd number, each within one clip; what is over at a clip's end is left out.

    Inputs that are ``held`` act from one sample until the next: theirs are means from one middle to the next.
    """
    rows, later, segments, at = [], [], [], 0
    for start, stop in motion.segments:
        groups = (stop - start) // n
        if groups < 2:
            continue
        index = start + np.arange(groups * n).reshape(groups, n)
        rows.append(index)
        later.append(np.minimum(index + n // 2, stop - 1))
        segments.append((at, at + groups))
        at += groups
    if not rows:
        return motion
    group = np.concatenate(rows)
    return replace(
        motion,
        time_s=motion.time_s[group].mean(axis=1),
        q=motion.q[group].mean(axis=1),
        v=None if motion.v is None else motion.v[group].mean(axis=1),
        u=motion.u[np.concatenate(later) if held else group].mean(axis=1),
        segments=tuple(segments),
    )
