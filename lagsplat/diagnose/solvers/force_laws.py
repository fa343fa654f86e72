"""Force laws, compiled one by one and called by their addresses, and their memories along a recorded motion.

A new law compiles alone, and one compiled rollout serves all of them.
"""

from typing import Any, no_type_check

import numpy as np
from llvmlite import ir
from numba import cfunc, float64, njit, types
from numba.extending import intrinsic

VECTOR = float64[::1]
FORCE_LAW_SIGNATURE = float64(float64, float64, float64, float64, float64, VECTOR, VECTOR, VECTOR)
"""``law(t, s, v, spring, drive, memory, theta, d_memory) -> acceleration``; writes the rate of its memory."""
MEMORY_STEPS = 8  # midpoint steps of a force law's memory between two frames


def compile_force_law(function: Any) -> Any:
    """Compile a force law under the signature that all of them share; a decorator.

    The compiled law has an ``address``, by which the functions of this module call it. No error can pass that
    way: a division by zero gives infinity or NaN, which ends a rollout as diverged.
    """
    return cfunc(FORCE_LAW_SIGNATURE, cache=True, error_model="numpy")(function)


@intrinsic
@no_type_check
def call_law(typing_context, address, t, s, v, spring, drive, memory, theta, d_memory):
    """Call the force law that is compiled at an address."""

    def generate(context, builder, signature, values):
        result, *arguments = (
            context.get_value_type(each) for each in (signature.return_type, *signature.args[1:])
        )
        pointer = ir.FunctionType(result, arguments).as_pointer()
        return builder.call(builder.inttoptr(values[0], pointer), values[1:])

    return FORCE_LAW_SIGNATURE.return_type(types.int64, *FORCE_LAW_SIGNATURE.args), generate


@njit(cache=True)
@no_type_check
def integrate_memory(law, theta, time, motion, clips, begin, out):
    """Write a force law's memory along a recorded motion by the explicit midpoint rule, compiled.

    Args:
        law, theta: address of the compiled law, and its parameters (P, n).
        time: times of the frames (N,) [s].
        motion: along the law's direction, the coordinate, its rate, and the simulator's conservative and
            actuated acceleration (N, 4); linear between frames.
        clips: first frame and end of each clip (C, 2).
        begin: memory where each clip starts (P, C, Z).
        out: memory at the frames (P, N, Z), written.
    """
    n_sets, _, n_z = out.shape
    rate, y, z, x = np.zeros(n_z), np.zeros(n_z), np.zeros(n_z), np.zeros(4)
    for p in range(n_sets):
        for clip in range(clips.shape[0]):
            z[:] = begin[p, clip]
            for n in range(clips[clip, 0], clips[clip, 1]):
                out[p, n] = z
                if n + 1 == clips[clip, 1]:
                    break
                h = (time[n + 1] - time[n]) / MEMORY_STEPS
                for step in range(MEMORY_STEPS):
                    for half in range(2):
                        share = (step + 0.5 * half) / MEMORY_STEPS
                        for i in range(n_z):
                            y[i] = z[i] + 0.5 * h * rate[i] if half == 1 else z[i]
                        for i in range(4):
                            x[i] = motion[n, i] + share * (motion[n + 1, i] - motion[n, i])
                        t = time[n] + share * MEMORY_STEPS * h
                        call_law(law, t, x[0], x[1], x[2], x[3], y, theta[p], rate)
                    for i in range(n_z):
                        z[i] += h * rate[i]
