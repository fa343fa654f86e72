"""The acceleration that a diagnosis found missing, at any state: what its effects add to the sim."""

from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.augmented import Augmented
from lagsplat.diagnose.play import Drive, play

Vector = Float64[np.ndarray, " d"]


class Missing:
    """Compares a sim with and without its diagnosed effects over one step, from the same state.

    Effects with a memory begin anew at every call, and those at instants of the recording act as at its
    start.
    """

    def __init__(self, one: Augmented) -> None:
        own = sum(len(effect.effect.parameters) for effect in one.effects)
        self.whole, self.plain = one, replace(one, effects=(), x=one.x[own:])

    def acceleration(self, q: Vector, v: Vector, u: Float64[np.ndarray, " n_u"]) -> Vector:
        """What is missing at a state and its velocity under held inputs [1/s^2].

        Raises:
            ValueError: numbers of coordinates or inputs that are not the sim's.
        """
        step_s = self.whole.step_s
        drive = Drive(np.array([0.0, step_s]), np.stack([u, u]))
        with_effects, without = (play(one, drive, q=q, v=v)[1][1] for one in (self.whole, self.plain))
        return (with_effects - without) / step_s
