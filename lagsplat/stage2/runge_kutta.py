"""The classical Runge-Kutta step, for arrays and tensors alike."""

from collections.abc import Callable
from typing import Any, TypeVar

State = TypeVar("State")  # an array or a tensor


def take_runge_kutta_step(
    rate: Callable[[State, Any], State],
    state: State,
    step: Any,
    points: tuple[Any, Any, Any],
) -> State:
    """The state one step of ``d state/dt = rate(state, point)`` later, for any shape.

    ``step``, in the unit of time of ``rate``, broadcasts to ``state``; ``points`` are what ``rate`` takes
    besides the state (times or inputs) at the step's start, middle and end.

    Source: Hairer, Norsett and Wanner, Solving Ordinary Differential Equations I, 2nd ed., II.1.
    """
    x: Any = state
    start, middle, end = points
    k1: Any = rate(x, start)
    k2: Any = rate(x + 0.5 * step * k1, middle)
    k3: Any = rate(x + 0.5 * step * k2, middle)
    k4: Any = rate(x + step * k3, end)
    return x + step / 6.0 * (k1 + 2.0 * k2 + 2.0 * k3 + k4)
