"""The classical Runge-Kutta step, for arrays and tensors alike, and its derivatives."""

from collections.abc import Callable, Sequence
from typing import Any, TypeVar

import torch
from jaxtyping import Float
from torch import Tensor

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


def differentiate_runge_kutta_step(
    slopes: Sequence[Float[Tensor, "B s s"]], step: Float[Tensor, "B 1 1"]
) -> tuple[Float[Tensor, "B s s"], list[Float[Tensor, "B s s"]]]:
    """Derivatives of a step's end by its start and by the rate at each of the four stages.

    Args:
        slopes: derivative of the rate by the state at each stage.
        step: length of the step.
    """
    eye = torch.eye(slopes[0].shape[-1], dtype=slopes[0].dtype)
    by_rate = [step / 6.0 * eye]
    for slope, reach, share in zip(slopes[:0:-1], (1.0, 0.5, 0.5), (2.0, 2.0, 1.0), strict=True):
        by_rate.insert(0, share * step / 6.0 * eye + reach * step * (by_rate[0] @ slope))
    by_start = eye + sum(rate @ slope for rate, slope in zip(by_rate, slopes, strict=True))
    return by_start, by_rate
