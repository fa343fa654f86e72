"""The learned law in NumPy, for one state or a batch: long rollouts, the live viewer, exported pages.

A step of a small law in torch is nearly all overhead; the same formulas on plain arrays take about a quarter
of the time. `lagsplat.stage2.lagrangian` is the specification.
"""

import numpy as np
from jaxtyping import Float64
from torch import Tensor

from lagsplat.monomials import ROOM
from lagsplat.stage2.lagrangian import UNTOUCHED, Lagrangian, LawEdits
from lagsplat.stage2.networks import ConstantMatrix, Icnn, MatrixField
from lagsplat.stage2.polynomials import LOADS, SPRINGS, PolynomialEnergy, PolynomialField, PolynomialMap
from lagsplat.stage2.rollout import split_inputs
from lagsplat.stage2.runge_kutta import take_runge_kutta_step

States = Float64[np.ndarray, "*B d"]
Inputs = Float64[np.ndarray, "*B n_u"]
Values = Float64[np.ndarray, "*B"] | float
Paths = Float64[np.ndarray, "B N d"]


class NumpyLagrangian:
    """A `Lagrangian` as it is now, with its edits, in arrays; later changes of its parameters do not enter.

    States `q` and velocities `v` are (d,) or (B, d); inputs `u` (n_u,) or (B, n_u), or None for zero inputs.

    Raises:
        ValueError: the mass is induced by the decoder, whose sums over Gaussians gain nothing here.

    Source: paper eqs. (EL), (pressure) and (forced-eom).
    """

    def __init__(self, law: Lagrangian, *, edits: LawEdits = UNTOUCHED) -> None:
        if not isinstance(law.mass_term, MatrixField | ConstantMatrix | PolynomialField):
            raise ValueError(
                "a mass induced by the decoder has no closed form in arrays: "
                "take lagsplat.stage2.rollout.rollout or lagsplat.forces.loaded_lagrangian.TorchLagrangian"
            )
        ready = law.prepare()
        self.edits, self.d, self.signed = edits, law.d, law.signed
        self.unit_s, self.longest_step = float(law.time_unit_s), law.longest_step
        self.integrator = law.integrator
        self.mass, self.damping = _to_arrays(law.mass_term), _to_arrays(law.damping_term)
        self.coordinates = None if law.coordinates is None else CoordinatesInArrays(law.coordinates)
        self.energy = None
        if law.energy is not None and self.coordinates is not None:
            self.energy = PolynomialForces(law.energy, self.coordinates.evaluate(_array(law.rest))[0])
        self.blocks = [tuple(_array(part) for part in block) for block in ready.blocks]
        self.stiffness, self.rest_image = _array(ready.stiffness), _array(ready.rest_image)[0]
        self.rest_slope, self.pressure_map = _array(ready.rest_slope)[0], _array(law.pressure_map)
        self.curvature = None if ready.curvature is None else _array(ready.curvature)
        self.convex = self.volume = None
        if law.convex is not None and ready.between is not None:
            self.convex = ConvexNet(law.convex, ready.between)
        if law.volume_net is not None and ready.between_volume is not None:
            self.volume = ConvexNet(law.volume_net, ready.between_volume)

    def conservative_force(self, q: States, u: Inputs | None = None) -> States:
        """``-grad_q (k V - u.nu)`` with the edit ``k`` of the stiffness."""
        if self.energy is not None and self.coordinates is not None:
            x, jacobian = self.coordinates.evaluate(q)
            force = -self.edits.stiffness * self.energy.elastic_slope(x)
            if u is not None and u.shape[-1]:
                force = force + self.energy.input_force(x, u)
            return (force[..., None, :] @ jacobian)[..., 0, :]
        image, hidden = self._push(q)
        offset = image - self.rest_image
        slope = offset @ self.stiffness - self.rest_slope
        if self.convex is not None:
            slope = slope + self.convex.gradient(image, self.convex.head[0])
        slope = self.edits.stiffness * slope
        if u is not None and u.shape[-1]:
            slope = slope - u @ self.pressure_map
            if self.curvature is not None:
                slope = slope + np.einsum("...c,cij,...j->...i", u, self.curvature, offset)
            if self.volume is not None:
                shares = np.concatenate([np.maximum(u, 0.0), np.maximum(-u, 0.0)], -1) if self.signed else u
                slope = slope + self.volume.gradient(image, shares @ self.volume.head)
        for (inner, _, outer, _), h in zip(reversed(self.blocks), reversed(hidden), strict=True):
            slope = slope + ((slope @ outer) * (1.0 - h * h)) @ inner
        return -slope

    def acceleration(
        self, q: States, v: States, u: Inputs | None = None, load: States | float = 0.0
    ) -> States:
        """Acceleration in internal time units, under the generalised force ``load`` beside the law's own."""
        force = load + self.conservative_force(q, u)
        if self.coordinates is None:
            force = force - self.edits.damping * self.damping.product(q, v)
            return self.mass.accelerate(q, v, force / self.edits.inertia)
        x, jacobian = self.coordinates.evaluate(q)
        w, bending = self.coordinates.differentiate(q, v)
        pulled = np.linalg.solve(jacobian.swapaxes(-1, -2), force[..., None])[..., 0]
        pulled = pulled - self.edits.damping * self.damping.product(x, w)
        a = self.mass.accelerate(x, w, pulled / self.edits.inertia)
        return np.linalg.solve(jacobian, (a - bending)[..., None])[..., 0]

    def potential(self, q: States) -> Values:
        """``k V(q)``, zero at the rest state of the law."""
        if self.energy is not None and self.coordinates is not None:
            return self.edits.stiffness * self.energy.potential(self.coordinates.evaluate(q)[0])
        image, _ = self._push(q)
        offset = image - self.rest_image
        value = 0.5 * ((offset @ self.stiffness) * offset).sum(-1)
        if self.convex is not None:
            head = self.convex.head[0]
            rise = self.convex.value(image, head) - self.convex.value(self.rest_image, head)
            value = value + rise - offset @ self.rest_slope
        return self.edits.stiffness * value

    def kinetic(self, q: States, v: States) -> Values:
        """``m v.M v / 2`` at a velocity in 1/s."""
        x, w = self._push_forward(q, v * self.unit_s)
        return 0.5 * self.edits.inertia * (w * self.mass.product(x, w)).sum(-1)

    def dissipated_power(self, q: States, v: States) -> Values:
        """``c v.C v`` per second, at a velocity in 1/s."""
        x, w = self._push_forward(q, v * self.unit_s)
        return self.edits.damping * (w * self.damping.product(x, w)).sum(-1) / self.unit_s

    def step(
        self, q: States, v: States, u: Inputs | None = None, load: States | float = 0.0, *, dt_s: float
    ) -> tuple[States, States]:
        """State and velocity [1/s] ``dt_s`` later under constant input and load.

        Takes as many steps of the law's integrator as `lagsplat.stage2.rollout.advance`.
        """
        q, w = self.advance(q, v * self.unit_s, u, load, step=dt_s / self.unit_s)
        return q, w / self.unit_s

    def advance(
        self, q: States, w: States, u: Inputs | None, load: States | float, *, step: float
    ) -> tuple[States, States]:
        """Make a `step` in internal time units; ``w`` is the velocity in them."""
        pieces = split_inputs(step, self.longest_step)
        h = step / pieces
        for _ in range(pieces):
            if self.integrator == "runge_kutta":
                q, w = self._take_runge_kutta_step(q, w, u, load, h)
                continue
            a = self.acceleration(q, w, u, load)
            half = w + (0.5 * h) * a
            q = q + h * half
            w = half + (0.5 * h) * self.acceleration(q, half + (0.5 * h) * a, u, load)
        return q, w

    def _take_runge_kutta_step(
        self, q: States, w: States, u: Inputs | None, load: States | float, h: float
    ) -> tuple[States, States]:
        def rate(state: States, _: None) -> States:
            x, speed = state[..., : self.d], state[..., self.d :]
            return np.concatenate([speed, self.acceleration(x, speed, u, load)], axis=-1)

        state = take_runge_kutta_step(rate, np.concatenate([q, w], axis=-1), h, (None, None, None))
        return state[..., : self.d], state[..., self.d :]

    def _push_forward(self, q: States, v: States) -> tuple[States, States]:
        """State and velocity in the coordinates of mass and damping."""
        if self.coordinates is None:
            return q, v
        return self.coordinates.evaluate(q)[0], self.coordinates.differentiate(q, v)[0]

    def _push(self, q: States) -> tuple[States, list[np.ndarray]]:
        image, hidden = q, []
        for inner, inner_bias, outer, outer_bias in self.blocks:
            hidden.append(np.tanh(image @ inner.T + inner_bias))
            image = image + hidden[-1] @ outer.T + outer_bias
        return image, hidden


def roll_out_free(
    law: NumpyLagrangian, q0: States, v0: States, *, states: int, dt_s: float, load: States | float = 0.0
) -> tuple[Paths, Paths]:
    """States and velocities [1/s] at ``states`` instants ``dt_s`` apart, the first as given.

    The scheme is that of `lagsplat.stage2.rollout.rollout`; inputs are zero, and the generalised force
    ``load``, (B, d) or one number for all, is constant. Never raises on divergence: what leaves the finite
    numbers is not finite from there on.
    """
    q, w = q0.astype(np.float64), v0 * law.unit_s
    positions, velocities = [q], [w]
    with np.errstate(all="ignore"):
        for _ in range(1, states):
            q, w = law.advance(q, w, None, load, step=dt_s / law.unit_s)
            positions.append(q)
            velocities.append(w)
    return np.moveaxis(np.stack(positions), 0, 1), np.moveaxis(np.stack(velocities), 0, 1) / law.unit_s


class ConstantSpd:
    """A constant mass or damping matrix in arrays."""

    net: None = None

    def __init__(self, term: ConstantMatrix) -> None:
        self.lower, self.floor = np.tril(_array(term.factor)), term.floor
        self.matrix = self.lower @ self.lower.T + self.floor * np.eye(len(self.lower))
        self.inverse = np.linalg.inv(self.matrix)

    def product(self, q: States, v: States) -> States:
        """``S v``."""
        return v @ self.matrix

    def accelerate(self, q: States, v: States, force: States) -> States:
        """``S^-1 force``; a constant matrix has no velocity forces."""
        return force @ self.inverse


class SpdField:
    """A mass or damping matrix that depends on the state: `MatrixField` in arrays."""

    def __init__(self, field: MatrixField) -> None:
        self.lower, self.floor = np.tril(_array(field.factor)), field.floor
        self.eye = np.eye(len(self.lower))
        # entries above the diagonal are kept at zero, as the field's mask does
        third = _array(field.third) * _array(field.mask).reshape(-1, 1)
        layers = (field.first, field.first_bias, field.second, field.second_bias)
        self.net = (*(_array(part) for part in layers), third)

    def product(self, q: States, v: States) -> States:
        """``S(q) v``."""
        _, _, e = self._factor(q)
        y = (v @ self.lower)[..., None, :] @ e
        return (y @ e.swapaxes(-1, -2))[..., 0, :] @ self.lower.T + self.floor * v

    def accelerate(self, q: States, v: States, force: States) -> States:
        """``S^-1 (force + grad_q (v.S v / 2) - (dS/dt) v)``."""
        first, _, second, _, third = self.net
        h1, h2, e = self._factor(q)
        s1, s2 = 1.0 - h1 * h1, 1.0 - h2 * h2
        y = (v @ self.lower)[..., :, None]
        p = e.swapaxes(-1, -2) @ y
        rate = ((((v @ first.T) * s1) @ second.T) * s2 @ third.T).reshape(e.shape)
        change = (rate @ p + e @ (rate.swapaxes(-1, -2) @ y))[..., 0] @ self.lower.T
        back = (y @ p.swapaxes(-1, -2)).reshape(*q.shape[:-1], -1) @ third
        gradient = (((back * s2) @ second) * s1) @ first
        whole = self.lower @ e
        matrix = whole @ whole.swapaxes(-1, -2) + self.floor * self.eye
        total = force + gradient - change
        if len(self.eye) == 1:
            return total / matrix[..., 0]
        return np.linalg.solve(matrix, total[..., None])[..., 0]

    def _factor(self, q: States) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
        first, first_bias, second, second_bias, third = self.net
        h1 = np.tanh(q @ first.T + first_bias)
        h2 = np.tanh(h1 @ second.T + second_bias)
        return h1, h2, self.eye + (h2 @ third.T).reshape(*q.shape[:-1], *self.eye.shape)


class PolynomialSpd:
    """A mass or damping matrix of polynomials: `PolynomialField` in arrays."""

    net: None = None

    def __init__(self, field: PolynomialField) -> None:
        self.inner, self.floor, self.ball = _array(field.inner()), field.floor, _array(field.frame.ball)
        self.exponents = _array(field.frame.exponents).astype(int)
        self.coefficients, self.eye = _array(field.frame.coefficients), np.eye(field.frame.d)

    def product(self, q: States, v: States) -> States:
        """``S(q) v``."""
        frame, _ = self._evaluate_frame(q)
        return ((v[..., None, :] @ frame.swapaxes(-1, -2)) @ self.inner @ frame)[..., 0, :] + self.floor * v

    def accelerate(self, q: States, v: States, force: States) -> States:
        """``S^-1 (force + grad_q (v.S v / 2) - (dS/dt) v)``."""
        frame, slope = self._evaluate_frame(q)
        carried = frame.swapaxes(-1, -2) @ self.inner
        moved = np.einsum("...ijl,...j->...il", slope, v)
        turning = moved - np.einsum("...ijl,...l->...ij", slope, v)
        change = (carried @ moved - turning.swapaxes(-1, -2) @ self.inner @ frame) @ v[..., None]
        matrix = carried @ frame + self.floor * self.eye
        return np.linalg.solve(matrix, force[..., None] - change)[..., 0]

    def _evaluate_frame(self, q: States) -> tuple[np.ndarray, np.ndarray]:
        value, slope = evaluate_monomials_in_arrays(q, self.exponents, ball=self.ball)
        frame = self.eye + np.einsum("...k,kij->...ij", value, self.coefficients)
        return frame, np.einsum("...kl,kij->...ijl", slope, self.coefficients)


class PolynomialForces:
    """The slopes of a `PolynomialEnergy` in arrays, its potential zero at ``rest``."""

    def __init__(self, energy: PolynomialEnergy, rest: States) -> None:
        self.ball = _array(energy.ball)
        self.exponents = _array(energy.exponents).astype(int)
        self.input_exponents = _array(energy.input_exponents).astype(int)
        self.coefficients = _array(energy.coefficients)
        self.input_coefficients = _array(energy.input_coefficients)
        self.at_rest = self._energy(rest)

    def potential(self, q: States) -> Values:
        """``V(q)``."""
        return self._energy(q) - self.at_rest

    def elastic_slope(self, q: States) -> States:
        """``grad V``."""
        _, slope = evaluate_monomials_in_arrays(q, self.exponents, ball=self.ball, free_degree=SPRINGS)
        return np.einsum("k,...kd->...d", self.coefficients, slope)

    def input_force(self, q: States, u: Inputs) -> States:
        """``grad (u.nu)``."""
        _, slope = evaluate_monomials_in_arrays(q, self.input_exponents, ball=self.ball, free_degree=LOADS)
        return np.einsum("...k,...kd->...d", u @ self.input_coefficients, slope)

    def _energy(self, q: States) -> Values:
        value, _ = evaluate_monomials_in_arrays(q, self.exponents, ball=self.ball, free_degree=SPRINGS)
        return value @ self.coefficients


class CoordinatesInArrays:
    """A `PolynomialMap` in arrays."""

    def __init__(self, coordinates: PolynomialMap) -> None:
        self.exponents, self.ball = _array(coordinates.exponents).astype(int), _array(coordinates.ball)
        self.coefficients, self.eye = _array(coordinates.coefficients), np.eye(coordinates.d)

    def evaluate(self, q: States) -> tuple[States, np.ndarray]:
        """``g`` and its Jacobian matrix."""
        value, slope = evaluate_monomials_in_arrays(q, self.exponents, ball=self.ball)
        return q + value @ self.coefficients, self.eye + self.coefficients.T @ slope

    def differentiate(self, q: States, v: States) -> tuple[States, States]:
        """First and second derivative of ``g`` along the line ``q + t v``."""
        first, second = differentiate_monomials_along(q, v, self.exponents, ball=self.ball)
        return v + first @ self.coefficients, second @ self.coefficients


class ClipInArrays:
    """`lagsplat.monomials.SoftClip` in arrays."""

    def __init__(self, q: States, ball: np.ndarray) -> None:
        center, radius = ball[:-1], ball[-1]
        self.z = q - center
        self.r = np.maximum(np.linalg.norm(self.z, axis=-1, keepdims=True), radius)
        tanh = np.tanh((self.r - radius) / (ROOM * radius))
        self.slope = 1.0 - tanh * tanh
        self.share = radius * (1.0 + ROOM * tanh) / self.r
        self.first = (self.slope - self.share) / self.r
        self.second = (-2.0 / (ROOM * radius) * tanh * self.slope - 2.0 * self.first) / self.r
        self.s = center + self.share * self.z

    def move(self, v: States) -> tuple[States, States]:
        """First and second derivatives of ``s`` along the line ``q + t v``."""
        radial = (self.z * v).sum(-1, keepdims=True) / self.r
        turning = ((v * v).sum(-1, keepdims=True) - radial * radial) / self.r
        change = self.first * radial
        bend = self.second * radial * radial + self.first * turning
        return self.share * v + change * self.z, 2.0 * change * v + bend * self.z


def evaluate_monomials_in_arrays(
    q: States, exponents: np.ndarray, *, ball: np.ndarray, free_degree: int = 0
) -> tuple[np.ndarray, np.ndarray]:
    """`lagsplat.monomials.evaluate_monomials` in arrays: values (*B, k) and gradients (*B, k, d)."""
    clip, free = ClipInArrays(q, ball), exponents.sum(1, keepdims=True) <= free_degree
    s, d = np.where(free, q[..., None, :], clip.s[..., None, :]), q.shape[-1]
    factors = s**exponents
    lowered = exponents * s ** np.maximum(exponents - 1, 0)
    others = [np.delete(factors, i, axis=-1).prod(-1) for i in range(d)]
    slopes = lowered * np.stack(others, -1)
    along = (slopes @ clip.z[..., None]) * (clip.first / clip.r)[..., None]
    pulled = clip.share[..., None] * slopes + along * clip.z[..., None, :]
    return factors.prod(-1), np.where(free, slopes, pulled)


def differentiate_monomials_along(
    q: States, v: States, exponents: np.ndarray, *, ball: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """First and second derivatives (*B, k) of monomials along the line ``q + t v``."""
    clip = ClipInArrays(q, ball)
    speed, change = clip.move(v)
    value, first, second = (np.full((*q.shape[:-1], len(exponents)), each) for each in (1.0, 0.0, 0.0))
    for i, power in enumerate(exponents.T):
        x, dx, ddx = (part[..., i, None] for part in (clip.s, speed, change))
        by_x = power * x ** np.maximum(power - 1, 0)
        by_xx = power * (power - 1) * x ** np.maximum(power - 2, 0)
        own, own_first, own_second = x**power, by_x * dx, by_xx * dx * dx + by_x * ddx
        second = second * own + 2.0 * first * own_first + value * own_second
        first = first * own + value * own_first
        value = value * own
    return first, second


class ConvexNet:
    """`lagsplat.stage2.networks.Icnn` in arrays, with its prepared weights ``between``."""

    def __init__(self, net: Icnn, between: Tensor) -> None:
        self.first, self.first_bias = _array(net.first), _array(net.first_bias)
        self.second, self.second_bias = _array(net.second), _array(net.second_bias)
        self.between, self.head = _array(between), _array(net.head)

    def value(self, x: States, head: np.ndarray) -> Values:
        """The convex function with the weights ``head`` (h,) or (B, h) of its last layer."""
        h1 = np.logaddexp(0.0, x @ self.first.T + self.first_bias)
        return np.logaddexp(0.0, x @ self.second.T + self.second_bias + h1 @ self.between.T) @ head

    def gradient(self, x: States, head: np.ndarray) -> States:
        """Its gradient by ``x``."""
        z1 = x @ self.first.T + self.first_bias
        z2 = x @ self.second.T + self.second_bias + np.logaddexp(0.0, z1) @ self.between.T
        g2 = _sigmoid(z2) * head
        return g2 @ self.second + ((g2 @ self.between) * _sigmoid(z1)) @ self.first


def _sigmoid(z: np.ndarray) -> np.ndarray:
    return 0.5 + 0.5 * np.tanh(0.5 * z)  # without overflow on either side


def _to_arrays(
    term: MatrixField | ConstantMatrix | PolynomialField,
) -> "ConstantSpd | SpdField | PolynomialSpd":
    if isinstance(term, PolynomialField):
        return PolynomialSpd(term)
    return SpdField(term) if isinstance(term, MatrixField) else ConstantSpd(term)


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().cpu().double().numpy().copy()
