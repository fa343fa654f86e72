"""A frame that is shaken: what the acceleration of the base does to the coordinates of a mechanism."""

import numpy as np
from numba import njit

CHAIN, BAG, ACROBOT = 0, 3, 5


@njit(cache=True)
def base_pull(kind, p, q, mass, pull):
    """Generalised forces (d,) by which a mechanism resists a unit acceleration of its base.

    The base of links and of the elastic pendulum moves sideways, that of the others along their first
    coordinate, of which ``mass`` (d, d) then has the column.
    """
    d = len(q)
    if kind == CHAIN:
        angle, carried = 0.0, 0.0
        for i in range(d):
            carried += p[1 + i]
        for i in range(d):
            angle += q[i]
            pull[i] = carried * p[1 + d + i] * np.cos(angle)
            carried -= p[1 + i]
        for i in range(d - 2, -1, -1):
            pull[i] += pull[i + 1]
    elif kind == ACROBOT:
        pull[1] = p[1] * p[4] * np.cos(q[0] + q[1])
        pull[0] = (p[0] * p[3] + p[1] * p[2]) * np.cos(q[0]) + pull[1]
    elif kind == BAG:
        pull[0] = p[0] * (p[3] + q[1]) * np.cos(q[0])
        pull[1] = p[0] * np.sin(q[0])
    else:
        for i in range(d):
            pull[i] = mass[i, 0]
