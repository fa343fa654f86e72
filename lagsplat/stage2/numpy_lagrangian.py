"""A learned law frozen for long free rollouts: its numbers in NumPy, without the machinery of training.

A step of a small law in torch is nearly all overhead. The same formulas on plain arrays take about a quarter
of the time, so that a thousand seconds of motion are seconds of work.
"""

from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.stage2.networks import ConstantMatrix, MatrixField
from lagsplat.stage2.rollout import split_inputs

States = Float64[np.ndarray, "B d"]
Paths = Float64[np.ndarray, "B N d"]


class FrozenLaw:
    """`Lagrangian.acceleration` of a trained law at zero inputs, under a generalised force of one's own.

    Raises:
        ValueError: the mass is induced by the decoder, which has no closed form in these arrays.
    """

    def __init__(self, lagrangian: Lagrangian) -> None:
        if not isinstance(lagrangian.mass_term, MatrixField | ConstantMatrix):
            raise ValueError("a decoder-induced mass cannot be frozen: take lagsplat.stage2.rollout.rollout")
        ready = lagrangian.prepare()
        self.d, self.time_unit_s = lagrangian.d, float(lagrangian.time_unit_s)
        self.longest_step = lagrangian.longest_step
        self.blocks = [tuple(_array(part) for part in block) for block in ready.blocks]
        self.stiffness, self.image = _array(ready.stiffness), _array(ready.rest_image)
        self.slope = _array(ready.rest_slope)
        self.convex: dict[str, np.ndarray] | None = None
        if lagrangian.convex is not None and ready.between is not None:
            net = lagrangian.convex
            names = ("first", "first_bias", "second", "second_bias", "head")
            self.convex = {name: _array(getattr(net, name)) for name in names}
            self.convex["between"] = _array(ready.between)
        self.mass, self.damping = _matrix(lagrangian.mass_term), _matrix(lagrangian.damping_term)

    def acceleration(self, q: States, v: States, force: States | float = 0.0) -> States:
        """Acceleration in internal time units, under the law's own forces and ``force``."""
        push = force - self.slope_of_potential(q) - self.damping.product(q, v)
        return self.mass.accelerate(q, v, push)

    def slope_of_potential(self, q: States) -> States:
        """``dV/dq``."""
        image, hidden = q, []
        for inner, inner_bias, outer, outer_bias in self.blocks:
            hidden.append(np.tanh(image @ inner.T + inner_bias))
            image = image + hidden[-1] @ outer.T + outer_bias
        slope = (image - self.image) @ self.stiffness - self.slope
        if self.convex is not None:
            slope = slope + _convex_slope(image, **self.convex)
        for (inner, _, outer, _), h in zip(reversed(self.blocks), reversed(hidden), strict=True):
            slope = slope + ((slope @ outer) * (1.0 - h * h)) @ inner
        return slope


def roll_out_free(
    law: FrozenLaw, q0: States, v0: States, *, states: int, dt_s: float, force: States | float = 0.0
) -> tuple[Paths, Paths]:
    """States and velocities [1/s] at ``states`` instants ``dt_s`` apart, the first as given.

    The scheme is that of `lagsplat.stage2.rollout.rollout`, the inputs are zero and ``force`` is held. Never
    raises on divergence: what leaves the finite numbers is not finite from there on.
    """
    step = dt_s / law.time_unit_s
    pieces = split_inputs(step, law.longest_step)
    h = step / pieces
    q, v = q0.astype(np.float64), v0 * law.time_unit_s
    positions, velocities = np.empty((states, *q.shape)), np.empty((states, *q.shape))
    positions[0], velocities[0] = q, v
    with np.errstate(all="ignore"):
        for i in range(1, states):
            for _ in range(pieces):
                a = law.acceleration(q, v, force)
                half = v + (0.5 * h) * a
                q = q + h * half
                v = half + (0.5 * h) * law.acceleration(q, half + (0.5 * h) * a, force)
            positions[i], velocities[i] = q, v
    return np.moveaxis(positions, 0, 1), np.moveaxis(velocities, 0, 1) / law.time_unit_s


class _Constant:
    def __init__(self, matrix: np.ndarray) -> None:
        self.whole, self.inverse = matrix, np.linalg.inv(matrix)

    def product(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        return v @ self.whole

    def accelerate(self, q: np.ndarray, v: np.ndarray, force: np.ndarray) -> np.ndarray:
        return force @ self.inverse


class _Field:
    """`MatrixField` in arrays; the network's last layer is kept with its entries above the diagonal at 0."""

    def __init__(self, field: MatrixField) -> None:
        d = field.mask.shape[0]
        self.lower, self.floor, self.eye = np.tril(_array(field.factor)), field.floor, np.eye(d)
        self.first, self.first_bias = _array(field.first), _array(field.first_bias)
        self.second, self.second_bias = _array(field.second), _array(field.second_bias)
        self.third = _array(field.third) * _array(field.mask).reshape(-1, 1)

    def _hidden(self, q: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        h1 = np.tanh(q @ self.first.T + self.first_bias)
        h2 = np.tanh(h1 @ self.second.T + self.second_bias)
        return h1, h2, self.eye + (h2 @ self.third.T).reshape(-1, *self.eye.shape)

    def product(self, q: np.ndarray, v: np.ndarray) -> np.ndarray:
        e = self._hidden(q)[2]
        y = (v @ self.lower)[:, None] @ e
        return (y @ e.swapaxes(1, 2))[:, 0] @ self.lower.T + self.floor * v

    def accelerate(self, q: np.ndarray, v: np.ndarray, force: np.ndarray) -> np.ndarray:
        h1, h2, e = self._hidden(q)
        s1, s2 = 1.0 - h1 * h1, 1.0 - h2 * h2
        y = (v @ self.lower)[:, :, None]
        p = e.swapaxes(1, 2) @ y
        rate = ((((v @ self.first.T) * s1) @ self.second.T) * s2 @ self.third.T).reshape(e.shape)
        change = (rate @ p + e @ (rate.swapaxes(1, 2) @ y))[:, :, 0] @ self.lower.T
        back = (y @ p.swapaxes(1, 2)).reshape(len(q), -1) @ self.third
        gradient = (((back * s2) @ self.second) * s1) @ self.first
        whole = self.lower @ e
        matrix = whole @ whole.swapaxes(1, 2) + self.floor * self.eye
        total = force + gradient - change
        if len(self.eye) == 1:
            return total / matrix[:, :, 0]
        return np.linalg.solve(matrix, total[:, :, None])[:, :, 0]


def _matrix(term: Any) -> _Constant | _Field:
    if isinstance(term, MatrixField):
        return _Field(term)
    lower = np.tril(_array(term.factor))
    return _Constant(lower @ lower.T + term.floor * np.eye(len(lower)))


def _convex_slope(
    image: np.ndarray,
    *,
    first: np.ndarray,
    first_bias: np.ndarray,
    second: np.ndarray,
    second_bias: np.ndarray,
    between: np.ndarray,
    head: np.ndarray,
) -> np.ndarray:
    z1 = image @ first.T + first_bias
    z2 = image @ second.T + second_bias + np.logaddexp(0.0, z1) @ between.T
    g2 = _sigmoid(z2) * head
    return g2 @ second + ((g2 @ between) * _sigmoid(z1)) @ first


def _sigmoid(z: np.ndarray) -> np.ndarray:
    return 0.5 + 0.5 * np.tanh(0.5 * z)


def _array(tensor: Any) -> np.ndarray:
    return tensor.detach().cpu().double().numpy()
