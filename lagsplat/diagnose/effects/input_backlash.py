"""Play on the way of an input: it moves on only once its command has crossed a gap of ``width``.

Source: the play operator, Brokate and Sprekels, "Hysteresis and Phase Transitions", 1996.
"""

from typing import Any, no_type_check

import numpy as np
from jaxtyping import Float64
from numba import njit

from lagsplat.diagnose.effects.effect import HalfNormal, InputChange, Parameter


@njit(cache=True)
@no_type_check
def _play(values, begins, half, out):
    for p in range(half.shape[0]):
        for n in range(values.shape[0]):
            last = values[n] if begins[n] else out[p, n - 1]
            out[p, n] = min(max(last, values[n] - half[p]), values[n] + half[p])


def change(signal: Any, theta: Float64[np.ndarray, "P 1"]) -> Float64[np.ndarray, "P M"]:
    """The play operator on the input, centred where a clip begins."""
    out = np.empty((len(theta), len(signal.values)))
    _play(signal.values, signal.begins, np.ascontiguousarray(0.5 * np.abs(theta[:, 0])), out)
    return out


EFFECT = InputChange(
    name="input_backlash",
    group="C",
    equation="u = play of u_logged with a gap of width",
    parameters=(Parameter("width", "input", HalfNormal(0.5)),),
    needs="slow reversals of the input at two amplitudes",
    along="channels",
    change=change,
)
