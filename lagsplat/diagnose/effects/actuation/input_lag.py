"""An actuator that follows its command late: ``time_constant du/dt = command - u``."""

from collections.abc import Mapping
from typing import Any

import numpy as np
from jaxtyping import Float64
from numba import njit

from lagsplat.diagnose.effects.base import InputEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, log_normal


@njit(cache=True)
def _follow(time, values, begins, clip, constant, start, out):
    """Write the exact response to a command that is linear between samples."""
    for p in range(constant.shape[0]):
        for n in range(values.shape[0]):
            if begins[n]:
                out[p, n] = values[n] + start[p, clip[n]]
                continue
            h = time[n] - time[n - 1]
            if h <= 0.0:
                out[p, n] = out[p, n - 1]
                continue
            x = h / constant[p]
            fade = np.exp(-x)
            mean = (1.0 - fade) / x
            out[p, n] = fade * out[p, n - 1] + (mean - fade) * values[n - 1] + (1.0 - mean) * values[n]


def change(
    signal: Any, theta: Float64[np.ndarray, "P 1"], start: Float64[np.ndarray, "P C"]
) -> Float64[np.ndarray, "P M"]:
    """Filter the command by a first-order lag, which begins each clip off its command by ``start``."""
    out, constant = np.empty((len(theta), len(signal.values))), np.ascontiguousarray(theta[:, 0])
    _follow(signal.time, signal.values, signal.begins, signal.clip, constant, start, out)
    return out


def to_mujoco(element: Any, values: Mapping[str, Any]) -> tuple[str, ...]:
    """Give the actuator first-order dynamics, if it has none."""
    actuator, kinds = element.actuator, element.mujoco.mjtDyn
    if actuator.dyntype != kinds.mjDYN_NONE:
        return ()
    actuator.dyntype = kinds.mjDYN_FILTEREXACT
    actuator.dynprm[0] = values["time_constant"]
    return (f"actuator {actuator.name}: dyntype filterexact, dynprm {actuator.dynprm[0]:.6g}",)


EFFECT = InputEffect(
    name="input_lag",
    group="C",
    number=1,
    equation="time_constant du/dt = u_logged - u",
    parameters=(EffectParameter("time_constant", "time", log_normal(0.3, 1.0), (0.03, 0.1, 0.3, 1.0)),),
    needs="an input with steps or with frequencies above the lag's",
    acts_everywhere=True,
    change=change,
    memory=True,
    confusable_with=("input_delay", "time_offset"),
    mujoco=to_mujoco,
    title="an actuator that follows its command slowly",
    what="The actuator approaches its command gradually, as a filling chamber does.",
    symptom="Steps are answered gently, and fast commands are answered weakly and late.",
    remedy="Put a first-order filter before that input of the simulation.",
)
