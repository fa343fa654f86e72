"""A function and its rate of change along a direction, in one pass."""

from collections.abc import Callable

import torch
from torch import Tensor

Values = tuple[Tensor, ...]


def along(function: Callable[[Tensor], Values], point: Tensor, direction: Tensor) -> tuple[Values, Values]:
    """Values of ``function`` at ``point``, and their Jacobians times ``direction``.

    Both can be differentiated again, with respect to the point, the direction and what the function holds.
    """
    both = torch.func.jvp(function, (point,), (direction,))
    return both[0], both[1]
