"""Play between actuator and mechanism: the input follows once its command has crossed a gap of ``width``.

Source: the play operator, Brokate and Sprekels, "Hysteresis and Phase Transitions", 1996.
"""

from typing import Any

import numpy as np
from jaxtyping import Float64
from numba import njit

from lagsplat.diagnose.effects.base import InputEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, Normal, log_normal


@njit(cache=True)
def _play(values, begins, half, start, out):
    for p in range(half.shape[0]):
        for n in range(values.shape[0]):
            last = values[n] + start[p] * half[p] if begins[n] else out[p, n - 1]
            out[p, n] = min(max(last, values[n] - half[p]), values[n] + half[p])


def change(signal: Any, theta: Float64[np.ndarray, "P 2"]) -> Float64[np.ndarray, "P M"]:
    """Apply the play operator; ``start`` says where in the gap a clip begins, from -1 to 1."""
    out = np.empty((len(theta), len(signal.values)))
    half, start = 0.5 * theta[:, 0], np.clip(theta[:, 1], -1.0, 1.0)
    _play(signal.values, signal.begins, half, start, out)
    return out


EFFECT = InputEffect(
    name="input_backlash",
    group="C",
    number=5,
    equation="u = play of u_logged with a gap of width",
    parameters=(
        EffectParameter("width", "input", log_normal(0.5, 1.0), (0.1, 0.3, 0.8, 1.6, 2.6)),
        EffectParameter("start", "ratio", Normal(0.7), (-0.9, 0.0, 0.9)),
    ),
    needs="slow reversals of the input at two amplitudes",
    change=change,
    report_parameters=lambda p, placed: {"width": p["width"]},
    confusable_with=("input_dead_zone", "coulomb_friction"),
    mujoco="actuators have no play; it would need a body between motor and joint.",
    title="play between actuator and mechanism",
    what="After each reversal of the command some travel is lost before anything moves.",
    symptom="The response lags by the same amount of command in both directions.",
    remedy="Put play before that input of the simulation, or take up the slack.",
)
