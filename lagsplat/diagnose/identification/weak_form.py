"""A first model of a simulator by linear regression of the weak form of the Euler-Lagrange equations.

Multiplied by a test function and integrated by parts, the equations need no accelerations and are linear in
every coefficient. The scale of inertia is fixed by ``tr M_0 = d``.

Source: Messenger and Bortz, "Weak SINDy for partial differential equations", doi:10.1016/j.jcp.2021.110525.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.estimation.dataset import Dataset
from lagsplat.diagnose.mechanics.basis import Basis
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.mechanics.structure import ModelStructure


@dataclass(frozen=True)
class WeakFormSamples:
    """Samples of the motion in a certain basis, and the test functions."""

    basis: Basis
    dataset: Dataset
    q: Float64[np.ndarray, "N d"]
    v: Float64[np.ndarray, "N d"]
    width: Float64[np.ndarray, " d"]  # speed below which dry friction is linear
    tests: tuple[tuple[slice, np.ndarray, np.ndarray], ...]
    """Frames of each test function, and its values and its time derivative there, both times the step [s]."""


def build_weak_form_samples(
    basis: Basis, dataset: Dataset, q: np.ndarray, v: np.ndarray, *, width_s: float, speed: np.ndarray
) -> WeakFormSamples:
    """Place test functions ``(1 - s^2)^4`` on all clips, a quarter of their width apart.

    Args:
        basis: functions of the fields.
        dataset: the recordings.
        q: their smoothed coordinates (N, d).
        v: velocities (N, d).
        width_s: support of a test function [s].
        speed: speed (d,) below which dry friction is linear.
    """
    tests = []
    for start, stop in dataset.clips:
        time = dataset.time[start:stop]
        step = np.gradient(time) if stop - start > 1 else np.zeros(1)
        half = 0.5 * min(width_s, time[-1] - time[0])
        if stop - start < 8 or half <= 0.0:
            continue
        for centre in np.arange(time[0] + half, time[-1] - half + 1e-9, 0.5 * half):
            first, last = np.searchsorted(time, [centre - half, centre + half + 1e-12])
            s = (time[first:last] - centre) / half
            keep = np.clip(1.0 - s * s, 0.0, None)
            tests.append(
                (
                    slice(start + first, start + last),
                    keep**4 * step[first:last],
                    -8.0 * s / half * keep**3 * step[first:last],
                )
            )
    return WeakFormSamples(basis, dataset, q, v, speed, tuple(tests))


def build_regressors(
    samples: WeakFormSamples, structure: ModelStructure
) -> tuple[np.ndarray, np.ndarray, list[tuple]]:
    """The linear equations of the coefficients, ``rows @ coefficients = known``.

    Returns:
        ``rows`` (R, K), one for each test function and coordinate; ``known`` (R,); and for each column its
        field and the indices of its coefficient.
    """
    q, v, u, d = samples.q, samples.v, samples.dataset.u, samples.q.shape[1]
    phi, slope = samples.basis.values(q), samples.basis.slopes(q)
    forces, momenta, names = [], [], []  # a column is  int psi force + int psi' momentum, each (N, d)

    def add(name: tuple, force: np.ndarray, momentum: np.ndarray | None = None) -> None:
        names.append(name)
        forces.append(force)
        momenta.append(np.zeros_like(force) if momentum is None else momentum)

    for k in range(structure.mass):
        for i in range(d):
            for j in range(i, d):
                if k == 0 and i == j == d - 1:
                    continue  # fixed by the trace
                column = np.zeros_like(v)
                column[:, i] += v[:, j]
                energy = v[:, i] * v[:, j] * (0.5 if i == j else 1.0)
                if i != j:
                    column[:, j] += v[:, i]
                if k == 0 and i == j:
                    column[:, d - 1] -= v[:, d - 1]
                    add(("mass", k, i, j), np.zeros_like(v), -column)
                    continue
                add(("mass", k, i, j), -slope[:, k] * energy[:, None], -phi[:, k, None] * column)
    for k in range(1, structure.potential):
        add(("potential", k), slope[:, k])
    for k in range(structure.damping):
        for i in range(d):
            for j in range(i, d):
                column = np.zeros_like(v)
                column[:, i] += v[:, j]
                if i != j:
                    column[:, j] += v[:, i]
                add(("damping", k, i, j), phi[:, k, None] * column)
    for k in range(structure.input_map):
        for c in range(u.shape[1]):
            for i in range(d):
                column = np.zeros_like(v)
                column[:, i] = -phi[:, k] * u[:, c]
                add(("input_map", k, c, i), column)
    for flag, name in ((structure.dry, "dry"), (structure.drag, "drag")):
        for i in range(d) if flag else ():
            column = np.zeros_like(v)
            column[:, i] = np.tanh(v[:, i] / samples.width[i]) if name == "dry" else np.abs(v[:, i]) * v[:, i]
            add((name, i), column)
    rows = _integrate(samples, np.array(forces), np.array(momenta))
    known = np.array([np.einsum("n,nd->d", rate, v[frames]) for frames, _, rate in samples.tests])
    return rows.reshape(-1, len(names)), known.reshape(-1), names


def _integrate(samples: WeakFormSamples, forces: np.ndarray, momenta: np.ndarray) -> np.ndarray:
    """Integrals (T, d, K) of each column, given by forces and momenta (K, N, d), with each test function."""
    return np.array(
        [
            np.einsum("n,knd->dk", psi, forces[:, frames]) + np.einsum("n,knd->dk", rate, momenta[:, frames])
            for frames, psi, rate in samples.tests
        ]
    )


def build_model(
    samples: WeakFormSamples,
    structure: ModelStructure,
    coefficients: np.ndarray,
    names: list[tuple],
    rest: np.ndarray,
) -> MechanicalModel:
    """The model with the coefficients of a regression."""
    d, n_u = samples.q.shape[1], samples.dataset.u.shape[1]
    fields = {
        "mass": np.zeros((structure.mass, d, d)),
        "damping": np.zeros((structure.damping, d, d)),
        "potential": np.zeros(structure.potential),
        "input_map": np.zeros((structure.input_map, n_u, d)),
        "dry": np.zeros(d),
        "drag": np.zeros(d),
    }
    fields["mass"][0] = np.eye(d)
    for (name, *at), value in zip(names, coefficients, strict=True):
        array = fields[name]
        array[tuple(at)] += value
        if name in ("mass", "damping") and at[1] != at[2]:
            array[at[0], at[2], at[1]] += value
        if name == "mass" and at[0] == 0 and at[1] == at[2]:
            array[0, d - 1, d - 1] -= value
    return MechanicalModel(basis=samples.basis, width=samples.width, rest=rest, **fields)


def solve_ridge(rows: np.ndarray, known: np.ndarray, ridge: float) -> Float64[np.ndarray, " K"]:
    """Ridge regression of ``known`` (R,) on the standardised columns of ``rows`` (R, K)."""
    size = np.sqrt(np.mean(rows**2, axis=0)) + 1e-30
    a = rows / size
    gram = a.T @ a / len(a)
    return np.linalg.solve(gram + ridge * np.eye(len(size)), a.T @ known / len(a)) / size
