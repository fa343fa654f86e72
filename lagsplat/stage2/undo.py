"""Taking back steps after which the loss explodes."""

from collections import deque
from collections.abc import Sequence
from statistics import median

import torch
from torch import Tensor

EXPLODED = 5.0  # times the median of the recent losses
REMEMBERED = 20  # losses in that median
KEPT_EVERY = 10  # steps between two copies of good parameters
SHORTENED = 0.7  # factor on later steps each time one is taken back


class Undo:
    """Memory of good parameters during a descent.

    A rollout by explicit steps turns unstable when its fastest mode comes near the frame rate. Beyond that
    edge losses are astronomic and their gradients point nowhere, so a descent that stepped over cannot walk
    back: it is put back, and goes on with shorter steps.
    """

    def __init__(self, parameters: Sequence[Tensor]) -> None:
        self.parameters = parameters
        self.kept = [parameter.detach().clone() for parameter in parameters]
        self.recent: deque[float] = deque(maxlen=REMEMBERED)
        self.accepted = 0
        self.taken_back = 0

    @property
    def shortening(self) -> float:
        """Factor on the learning rate."""
        return SHORTENED**self.taken_back

    def accepts(self, loss: float) -> bool:
        """Whether the present parameters, of this loss, are good; if not, they are replaced by good ones."""
        good = loss < EXPLODED * median(self.recent) if self.recent else loss < float("inf")
        if not good:
            self.taken_back += 1
            with torch.no_grad():
                for parameter, kept in zip(self.parameters, self.kept, strict=True):
                    parameter.copy_(kept)
            return False
        if self.accepted % KEPT_EVERY == 0:
            self.kept = [parameter.detach().clone() for parameter in self.parameters]
        self.accepted += 1
        self.recent.append(loss)
        return True
