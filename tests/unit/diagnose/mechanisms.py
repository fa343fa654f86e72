"""Mechanisms whose equations can be written on one line, and their motions under any further force."""

from collections.abc import Callable
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from lagsplat.io.trajectory.trajectory import Trajectory

Force = Callable[[float, np.ndarray, np.ndarray, np.ndarray], np.ndarray]


class Mechanism:
    @property
    def rest(self):
        return np.zeros(self.d)

    @property
    def rest_inertia(self):
        return np.diagonal(self.mass_at(self.rest[None])[0])


@dataclass(frozen=True)
class Duffing(Mechanism):
    """m a = -k q - hard q^3 - damp v + gain u, one coordinate, at most one input."""

    m: float = 2.0
    k: float = 2.0 * (2 * np.pi) ** 2  # one swing a second
    hard: float = 20.0
    damp: float = 0.6
    gain: float = 3.0
    n_u: int = 1
    d: int = 1

    def mass_at(self, q):
        return np.broadcast_to(np.full((1, 1), self.m), (*q.shape, 1))

    def force(self, q, v, u):
        driven = self.gain * u[..., :1] if self.n_u else 0.0
        return -self.k * q - self.hard * q**3 - self.damp * v + driven

    def acceleration(self, q, v, u):
        return self.force(q, v, u) / self.m


@dataclass(frozen=True)
class TwoLink(Mechanism):
    """Two equal rods hung on each other, with relative joint angles and a little damping in each joint."""

    g: float = 9.81
    damp: float = 0.02
    n_u: int = 0
    d: int = 2

    def mass_at(self, q):
        c = np.cos(q[..., 1])
        return np.stack(
            [
                np.stack([5 / 3 + c, 1 / 3 + c / 2], axis=-1),
                np.stack([1 / 3 + c / 2, np.full_like(c, 1 / 3)], axis=-1),
            ],
            axis=-2,
        )

    def force(self, q, v, u):
        s = np.sin(q[..., 1])
        spin = 0.5 * s
        turned = v[..., 0] * v[..., 0]
        coriolis = np.stack([-spin * (2 * v[..., 0] * v[..., 1] + v[..., 1] ** 2), spin * turned], axis=-1)
        both = np.sin(q[..., 0] + q[..., 1])
        gravity = self.g * np.stack([1.5 * np.sin(q[..., 0]) + 0.5 * both, 0.5 * both], axis=-1)
        return -coriolis - gravity - self.damp * v

    def acceleration(self, q, v, u):
        return np.linalg.solve(self.mass_at(q), self.force(q, v, u)[..., None])[..., 0]


@dataclass(frozen=True)
class Chain(Mechanism):
    """Four unit masses in a row between walls, joined by springs; ``n_u`` pulls on the first ones."""

    n_u: int = 0
    d: int = 4
    k: float = 90.0

    def mass_at(self, q):
        return np.broadcast_to(np.eye(4), (*q.shape, 4))

    def force(self, q, v, u):
        stiffness = self.k * (2 * np.eye(4) - np.eye(4, k=1) - np.eye(4, k=-1))
        pulled = np.zeros_like(q)
        pulled[..., : self.n_u] = u
        return -q @ stiffness - 0.3 * v + pulled

    def acceleration(self, q, v, u):
        return self.force(q, v, u)


def still(t, q, v, u):
    return np.zeros_like(q)


def film(
    mechanism,
    seconds: float,
    *,
    start=(0.5,),
    force: Force = still,
    inputs: Callable[[np.ndarray], np.ndarray] | None = None,
    noise: float = 0.0,
    rate_hz: float = 60.0,
    seed: int = 0,
    times: np.ndarray | None = None,
    finer: int = 8,
) -> Trajectory:
    """The motion under ``force``, a generalised force of (t, q, v, u), by fine Runge-Kutta steps."""
    t = np.arange(round(seconds * rate_hz)) / rate_hz if times is None else times
    u = np.zeros((len(t), 0)) if inputs is None else np.reshape(inputs(t), (len(t), -1))
    state = np.array([*start, *np.zeros(mechanism.d)], dtype=float)
    d = mechanism.d

    def slope(now, x):
        at = np.array([np.interp(now, t, u[:, j]) for j in range(u.shape[1])])
        q, v = x[:d], x[d:]
        extra = np.linalg.solve(mechanism.mass_at(q), force(now, q, v, at))
        return np.concatenate([v, mechanism.acceleration(q, v, at) + extra])

    states = [state]
    for before, after in pairwise(t):
        h = (after - before) / finer
        for i in range(finer):
            now = before + i * h
            k1 = slope(now, state)
            k2 = slope(now + h / 2, state + h / 2 * k1)
            k3 = slope(now + h / 2, state + h / 2 * k2)
            k4 = slope(now + h, state + h * k3)
            state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        states.append(state)
    q = np.array(states)[:, :d]
    noisy = q + noise * q.std(axis=0) * np.random.default_rng(seed).standard_normal(q.shape)
    return Trajectory(time_s=t, q=noisy, u=u, source=f"film {seed}")
