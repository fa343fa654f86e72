"""The law for one state at a time, in numpy: what an interactive loop asks for between two pictures.

On vectors of a few numbers torch spends its time on calls. The same formulas as in `lagsplat.stage2`, whose
tensors stay the specification; `tests/oracle/test_single.py` holds the two together.

Whichever form of a law steps one state at a time: plain arrays, or tensors where the decoder gives the
mass.
"""

from typing import Any

import numpy as np
import torch
from jaxtyping import Float64
from torch import Tensor

from lagsplat.forces.loaded_lagrangian import UNTOUCHED, LawEdits, LoadedLagrangian
from lagsplat.stage2.decoder_mass import InducedMass
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.stage2.networks import ConstantMatrix, Icnn, MatrixField
from lagsplat.stage2.rollout import advance, split_inputs

Vector = Float64[np.ndarray, " d"]
Matrix = Float64[np.ndarray, "d d"]


class Single:
    """A law as it is now, with its edits; later changes of the law's parameters do not enter.

    Raises:
        ValueError: the law's mass is induced by a decoder, whose sums over Gaussians gain nothing here.

    Source: paper eq. (forced-eom).
    """

    def __init__(self, law: Lagrangian, *, edits: LawEdits = UNTOUCHED) -> None:
        with torch.no_grad():
            ready = law.prepare()
        if not isinstance(law.mass_term, MatrixField | ConstantMatrix):
            raise ValueError(
                "a mass induced by the decoder is integrated by lagsplat.forces.loaded_lagrangian alone"
            )
        self.edits, self.signed, self.longest_step = edits, law.signed, law.longest_step
        self.unit_s = float(law.time_unit_s)
        self.mass, self.damping = _Field(law.mass_term), _Field(law.damping_term)
        self.blocks = [tuple(_array(part) for part in block) for block in ready.blocks]
        self.stiffness, self.rest_image = _array(ready.stiffness), _array(ready.rest_image)[0]
        self.rest_slope, self.pressure_map = _array(ready.rest_slope)[0], _array(law.pressure_map)
        self.curvature = None if ready.curvature is None else _array(ready.curvature)
        self.convex = None if law.convex is None else _Convex(law.convex, ready.between)
        self.volume = None if law.volume_net is None else _Convex(law.volume_net, ready.between_volume)

    def conservative_force(self, q: Vector, u: Float64[np.ndarray, " n_u"]) -> Vector:
        """``-grad (k V - u.nu)`` with the edit ``k`` of the stiffness."""
        image, hidden = q, []
        for inner, inner_bias, outer, outer_bias in self.blocks:
            h = np.tanh(inner @ image + inner_bias)
            image = image + outer @ h + outer_bias
            hidden.append(h)
        offset = image - self.rest_image
        slope = self.stiffness @ offset - self.rest_slope
        if self.convex is not None:
            slope = slope + self.convex.gradient(image, self.convex.head[0])
        slope = self.edits.stiffness * slope
        if len(u):
            slope = slope - u @ self.pressure_map
            if self.curvature is not None:
                slope = slope + np.tensordot(u, self.curvature, 1) @ offset
            if self.volume is not None:
                shares = np.concatenate([np.maximum(u, 0.0), np.maximum(-u, 0.0)]) if self.signed else u
                slope = slope + self.volume.gradient(image, shares @ self.volume.head)
        for (inner, _, outer, _), h in zip(reversed(self.blocks), reversed(hidden), strict=True):
            slope = slope + ((slope @ outer) * (1.0 - h * h)) @ inner
        return -slope

    def acceleration(self, q: Vector, v: Vector, u: Float64[np.ndarray, " n_u"], load: Vector) -> Vector:
        """In internal time units, under the generalised force ``load``."""
        force = self.conservative_force(q, u) + load - self.edits.damping * self.damping.product(q, v)
        mass, velocity_force = self.mass.inertia(q, v)
        return np.linalg.solve(mass, force / self.edits.inertia + velocity_force)

    def potential(self, q: Vector) -> float:
        """``k V(q)``, zero at the rest state of the law."""
        image = q
        for inner, inner_bias, outer, outer_bias in self.blocks:
            image = image + outer @ np.tanh(inner @ image + inner_bias) + outer_bias
        offset = image - self.rest_image
        value = 0.5 * offset @ self.stiffness @ offset
        if self.convex is not None:
            head = self.convex.head[0]
            rise = self.convex.value(image, head) - self.convex.value(self.rest_image, head)
            value = value + rise - offset @ self.rest_slope
        return float(self.edits.stiffness * value)

    def kinetic(self, q: Vector, v: Vector) -> float:
        """``m v.M v / 2`` at a velocity in 1/s."""
        w = v * self.unit_s
        return float(0.5 * self.edits.inertia * w @ self.mass.product(q, w))

    def dissipated_power(self, q: Vector, v: Vector) -> float:
        """``c v.C v`` per second, at a velocity in 1/s."""
        w = v * self.unit_s
        return float(self.edits.damping * w @ self.damping.product(q, w) / self.unit_s)

    def step(
        self, q: Vector, v: Vector, u: Float64[np.ndarray, " n_u"], load: Vector, *, dt_s: float
    ) -> tuple[Vector, Vector]:
        """State and velocity [1/s] ``dt_s`` later, input and load held, by as many Verlet steps as
        `lagsplat.stage2.rollout.advance` takes.
        """
        pieces = split_inputs(dt_s / self.unit_s, self.longest_step)
        h, w = dt_s / self.unit_s / pieces, v * self.unit_s
        for _ in range(pieces):
            a = self.acceleration(q, w, u, load)
            half = w + 0.5 * h * a
            q = q + h * half
            w = half + 0.5 * h * self.acceleration(q, half + 0.5 * h * a, u, load)
        return q, w / self.unit_s


class _Convex:
    """`lagsplat.stage2.networks.Icnn` at one point."""

    def __init__(self, net: Icnn, between: Tensor | None) -> None:
        assert between is not None, "prepared together with the net"
        self.first, self.first_bias = _array(net.first), _array(net.first_bias)
        self.second, self.second_bias = _array(net.second), _array(net.second_bias)
        self.between, self.head = _array(between), _array(net.head)

    def value(self, x: Vector, head: Float64[np.ndarray, " h"]) -> float:
        h1 = np.logaddexp(0.0, self.first @ x + self.first_bias)
        return np.logaddexp(0.0, self.second @ x + self.second_bias + self.between @ h1) @ head

    def gradient(self, x: Vector, head: Float64[np.ndarray, " h"]) -> Vector:
        z1 = self.first @ x + self.first_bias
        z2 = self.second @ x + self.second_bias + self.between @ np.logaddexp(0.0, z1)
        g2 = _sigmoid(z2) * head
        return g2 @ self.second + ((g2 @ self.between) * _sigmoid(z1)) @ self.first


class _Field:
    """`lagsplat.stage2.networks.MatrixField` or a constant matrix at one point."""

    def __init__(self, term: MatrixField | ConstantMatrix) -> None:
        self.lower, self.floor = np.tril(_array(term.factor)), term.floor
        self.identity = np.eye(len(self.lower))
        self.net = None
        if isinstance(term, MatrixField):
            weights = (term.first, term.first_bias, term.second, term.second_bias, term.third)
            self.net = tuple(_array(weight) for weight in weights)
            self.mask = np.tril(np.ones_like(self.lower))

    def product(self, q: Vector, v: Vector) -> Vector:
        """``S(q) v``."""
        y = self.lower.T @ v
        if self.net is not None:
            _, _, e = self._at(q, *self.net)
            y = e @ (e.T @ y)
        return self.lower @ y + self.floor * v

    def inertia(self, q: Vector, v: Vector) -> tuple[Matrix, Vector]:
        """``S`` and the velocity forces ``grad_q (v.S v / 2) - (dS/dt) v``."""
        if self.net is None:
            return self.lower @ self.lower.T + self.floor * self.identity, np.zeros_like(v)
        h1, h2, e = self._at(q, *self.net)
        first, _, second, _, third = self.net
        s1, s2, y = 1.0 - h1 * h1, 1.0 - h2 * h2, self.lower.T @ v
        p = e.T @ y
        rate = (third @ (s2 * (second @ (s1 * (first @ v))))).reshape(e.shape) * self.mask
        change = self.lower @ (rate @ p + e @ (rate.T @ y))
        gradient = (((((np.outer(y, p) * self.mask).ravel() @ third) * s2) @ second) * s1) @ first
        whole = self.lower @ e
        return whole @ whole.T + self.floor * self.identity, gradient - change

    def _at(
        self,
        q: Vector,
        first: np.ndarray,
        first_bias: np.ndarray,
        second: np.ndarray,
        second_bias: np.ndarray,
        third: np.ndarray,
    ) -> tuple[np.ndarray, np.ndarray, Matrix]:
        h1 = np.tanh(first @ q + first_bias)
        h2 = np.tanh(second @ h1 + second_bias)
        return h1, h2, self.identity + (third @ h2).reshape(self.lower.shape) * self.mask


def convex_arrays(net: _Convex | None) -> dict[str, Any] | None:
    """The weights of a convex network of a `Single` as plain lists; None of None."""
    if net is None:
        return None
    return {
        "first": net.first.tolist(),
        "firstBias": net.first_bias.tolist(),
        "second": net.second.tolist(),
        "secondBias": net.second_bias.tolist(),
        "between": net.between.tolist(),
        "head": net.head.tolist(),
    }


def field_arrays(field: _Field) -> dict[str, Any]:
    """The numbers of a mass or damping of a `Single` as plain lists; ``net`` is None where it is constant."""
    names = ("first", "firstBias", "second", "secondBias", "third")
    net = None if field.net is None else {n: w.tolist() for n, w in zip(names, field.net, strict=True)}
    return {"lower": field.lower.tolist(), "floor": field.floor, "net": net}


def _array(tensor: Tensor) -> np.ndarray:
    return tensor.detach().double().cpu().numpy().copy()


def _sigmoid(x: np.ndarray) -> np.ndarray:
    return 0.5 * (1.0 + np.tanh(0.5 * x))  # without overflow on either side


Held = Float64[np.ndarray, " n_u"]


class Batched:
    """The tensors of a law for one state, as `Single`: for masses that are sums over the decoder's
    Gaussians."""

    def __init__(self, law: Lagrangian, *, edits: LawEdits = UNTOUCHED) -> None:
        self.edits, self.unit_s = edits, float(law.time_unit_s)
        self.law = LoadedLagrangian(law, torch.zeros(law.d, dtype=torch.float64), edits=edits)
        with torch.no_grad():
            self.ready = law.prepare()

    @torch.no_grad()
    def step(self, q: Vector, v: Vector, u: Held, load: Vector, *, dt_s: float) -> tuple[Vector, Vector]:
        """State and velocity [1/s] ``dt_s`` later, input and generalised force held."""
        self.law.load = torch.from_numpy(load)
        state, velocity = advance(
            self.law, _row(q), _row(v * self.unit_s), _row(u), step=dt_s / self.unit_s, ready=self.ready
        )
        return state[0].numpy(), velocity[0].numpy() / self.unit_s

    @torch.no_grad()
    def conservative_force(self, q: Vector, u: Held) -> Vector:
        """``-grad (V - u.nu)``."""
        self.law.load = torch.zeros_like(self.law.load)
        return self.law.conservative_force(_row(q), _row(u), self.ready)[0].numpy()

    @torch.no_grad()
    def potential(self, q: Vector) -> float:
        """``V(q)``."""
        self.law.load = torch.zeros_like(self.law.load)
        return float(self.law.potential(_row(q))[0])

    @torch.no_grad()
    def kinetic(self, q: Vector, v: Vector) -> float:
        """``v.M v / 2`` at a velocity in 1/s."""
        w = v * self.unit_s
        return float(0.5 * w @ self.law.mass(_row(q))[0].numpy() @ w)

    @torch.no_grad()
    def dissipated_power(self, q: Vector, v: Vector) -> float:
        """``v.C v`` per second, at a velocity in 1/s."""
        w = v * self.unit_s
        return float(w @ self.law.damping(_row(q))[0].numpy() @ w / self.unit_s)


def _row(x: np.ndarray) -> torch.Tensor:
    return torch.from_numpy(x)[None]


Stepper = Single | Batched
"""A law with its edits, one state at a time."""


def open_stepper(law: Lagrangian, *, edits: LawEdits = UNTOUCHED) -> Stepper:
    """The fastest of the two forms that can carry ``law``."""
    return Batched(law, edits=edits) if isinstance(law.mass_term, InducedMass) else Single(law, edits=edits)
