"""Masses that are added to a mechanism, or that all of it has more of: other parameters of its equations."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.gapgen import laws
from benchmarks.gapgen.effect import Effect
from benchmarks.gapgen.mechanisms import (
    ACROBOT,
    BAG,
    CART,
    CART_POLE,
    CHAIN,
    FURUTA,
    QUARTER_CAR,
    ROCKER,
    ROTATIONAL_ACTUATOR,
    Mechanism,
)

Array = NDArray[np.float64]


def masses_of(m: Mechanism) -> list[int]:
    """Positions of masses and inertias in the parameters."""
    if m.kind == CHAIN:
        return [*range(1, 1 + m.d), *range(1 + 2 * m.d, 1 + 3 * m.d)]
    slots = {
        **{ROCKER: [0], CART: [0], BAG: [0], CART_POLE: [0, 1], ACROBOT: [0, 1, 5, 6], FURUTA: [0, 1, 4]},
        QUARTER_CAR: [0, 1],
    }
    return slots[m.kind]


def with_payload(m: Mechanism, i: int, kg: float) -> Mechanism:
    """The mechanism with a point mass at the end of what the coordinate ``i`` moves.

    Raises:
        ValueError: where the equations have no such place.
    """
    p = m.p.copy()
    if m.kind == CHAIN:
        p[1 + i] += kg
    elif m.kind in (CART, BAG) or (m.kind in (CART_POLE, ROTATIONAL_ACTUATOR) and i == 0):
        p[0] += kg
    elif m.kind == ACROBOT:
        centre, inertia, far = (3, 5, p[2]) if i == 0 else (4, 6, 2.0 * p[4])
        whole = p[i] + kg
        moved = (p[i] * p[centre] + kg * far) / whole
        p[inertia] += p[i] * (moved - p[centre]) ** 2 + kg * (far - moved) ** 2
        p[i], p[centre] = whole, moved
    elif m.kind == FURUTA and i == 0:
        p[0] += kg * p[2] ** 2
    else:
        raise ValueError(f"{m.system}: no payload can be put at coordinate {i}")
    return replace(m, p=p)


def load(m: Mechanism, effects: list[Effect]) -> Mechanism:
    """The mechanism with the masses of its effects."""
    for effect in effects:
        for law, i, _, th in effect.rows:
            if law == laws.PAYLOAD:
                m = with_payload(m, i, th[0])
            elif law == laws.MASSES:
                p = m.p.copy()
                p[masses_of(m)] *= th[0]
                m = replace(m, p=p)
    return m
