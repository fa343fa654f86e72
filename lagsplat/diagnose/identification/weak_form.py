"""A first model of a simulator by linear regression of the weak form of the Euler-Lagrange equations.

Multiplied by a test function and integrated by parts, the equations need no accelerations and are linear in
every coefficient. The scale of inertia is fixed by ``tr M_0 = d``.

Source: Messenger and Bortz, "Weak SINDy for partial differential equations", doi:10.1016/j.jcp.2021.110525.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.core.config import IDENTIFICATION
from lagsplat.diagnose.estimation.dataset import Dataset
from lagsplat.diagnose.mechanics.basis import POWER, Basis
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.mechanics.structure import ModelStructure


@dataclass(frozen=True)
class WeakFormSamples:
    """Samples of the motion in a certain basis, and the test functions."""

    basis: Basis
    dataset: Dataset
    q: Float64[np.ndarray, "N d"]  # smoothed coordinates
    width: Float64[np.ndarray, " d"]  # speed below which dry friction is linear
    tests: tuple[tuple[slice, np.ndarray, np.ndarray], ...]
    """Frames of each test function, and its values and its time derivative there, both times the step [s]."""


def build_weak_form_samples(
    basis: Basis, dataset: Dataset, q: np.ndarray, *, width_s: float, speed: np.ndarray
) -> WeakFormSamples:
    """Place test functions ``(1 - s^2)^4``, ``width_s`` [s] wide, on all clips, a quarter of that apart.

    ``q`` (N, d) are the smoothed coordinates, ``speed`` (d,) is that below which dry friction is linear.
    """
    tests = []
    for start, stop in dataset.clips:
        time = dataset.time[start:stop]
        half = 0.5 * min(width_s, time[-1] - time[0])
        if stop - start < 8 or half <= 0.0:
            continue
        step = np.gradient(time)
        for centre in np.arange(time[0] + half, time[-1] - half + 1e-9, 0.5 * half):
            first, last = np.searchsorted(time, [centre - half, centre + half + 1e-12])
            s = (time[first:last] - centre) / half
            keep = np.clip(1.0 - s * s, 0.0, None)
            value, rate = keep**4 * step[first:last], -8.0 * s / half * keep**3 * step[first:last]
            tests.append((slice(start + first, start + last), value, rate))
    return WeakFormSamples(basis, dataset, q, speed, tuple(tests))


def build_regressors(
    samples: WeakFormSamples, structure: ModelStructure
) -> tuple[np.ndarray, np.ndarray, list[tuple]]:
    """The linear equations of the coefficients, ``rows @ coefficients = known``.

    Returns:
        ``rows`` (R, K), one for each test function and coordinate; ``known`` (R,); and for each column its
        field and the indices of its coefficient.
    """
    v, u, d = samples.dataset.v, samples.dataset.u, samples.q.shape[1]
    phi, slope = samples.basis.values(samples.q), samples.basis.slopes(samples.q)
    forces, momenta, names = [], [], []  # a column is  int psi force + int psi' momentum, each (N, d)

    def add(name: tuple, force: np.ndarray, momentum: np.ndarray | None = None) -> None:
        names.append(name)
        forces.append(force)
        momenta.append(np.zeros_like(force) if momentum is None else momentum)

    def at(i: int, values: np.ndarray) -> np.ndarray:
        """A force (N, d) on coordinate ``i`` alone."""
        force = np.zeros_like(v)
        force[:, i] = values
        return force

    def couple(i: int, j: int) -> np.ndarray:
        """The symmetric matrix of ones at (i, j) and (j, i) times the velocities."""
        return at(i, v[:, j]) if i == j else at(i, v[:, j]) + at(j, v[:, i])

    pairs = [(i, j) for i in range(d) for j in range(i, d)]
    for k in range(structure.mass):
        for i, j in pairs:
            if k > 0 or i != j:
                energy = v[:, i] * v[:, j] * (0.5 if i == j else 1.0)
                add(("mass", k, i, j), -slope[:, k] * energy[:, None], -phi[:, k, None] * couple(i, j))
            elif i < d - 1:  # the last entry of the diagonal is fixed by the trace
                add(("mass", k, i, j), np.zeros_like(v), at(d - 1, v[:, d - 1]) - couple(i, j))
    for k in range(1, structure.potential):
        add(("potential", k), slope[:, k])
    for k in range(structure.damping):
        for i, j in pairs:
            add(("damping", k, i, j), phi[:, k, None] * couple(i, j))
    for k, c, i in np.ndindex(structure.input_map, u.shape[1], d):
        add(("input_map", k, c, i), at(i, -phi[:, k] * u[:, c]))
    for i in range(d if structure.dry else 0):
        add(("dry", i), at(i, np.tanh(v[:, i] / samples.width[i])))
    for i in range(d if structure.drag else 0):
        add(("drag", i), at(i, np.abs(v[:, i]) * v[:, i]))
    all_forces, all_momenta, rows, known = np.array(forces), np.array(momenta), [], []
    for frames, value, rate in samples.tests:
        column = np.einsum("n,knd->dk", value, all_forces[:, frames])
        rows.append(column + np.einsum("n,knd->dk", rate, all_momenta[:, frames]))
        known.append(np.einsum("n,nd->d", rate, v[frames]))
    return np.array(rows).reshape(-1, len(names)), np.array(known).reshape(-1), names


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


def fit_explicit_model(
    samples: WeakFormSamples, structure: ModelStructure, ridge: float, rest: np.ndarray
) -> MechanicalModel | None:
    """A linear model from the regression of the accelerations, instead of the forces.

    Where coordinates move together, as a cart and the pole that swings on it, the regression of forces may
    find one equation twice, with hardly any inertia across it. Accelerations are never trivial so. Of all
    symmetric inertias the one is taken that makes stiffness and damping most nearly symmetric.

    Returns:
        None where the potential of this structure is not a quadratic one.
    """
    basis, u, d = samples.basis, samples.dataset.u, samples.q.shape[1]
    order = basis.order[: structure.potential]
    if (basis.kind[: len(order)] != POWER).any() or order.sum(axis=1).max() != 2:
        return None
    x, rate = (samples.q - basis.centre) / basis.scale, samples.dataset.v / basis.scale
    columns = np.concatenate([np.ones((len(x), 1)), x, rate, u], axis=1)
    rows = np.array([value @ columns[frames] for frames, value, _ in samples.tests])
    known = np.array([-slope @ rate[frames] for frames, _, slope in samples.tests])
    solved = np.array([solve_ridge(rows, known[:, i], ridge) for i in range(d)])
    force, stiffness, damping, gain = np.split(solved, [1, 1 + d, 1 + 2 * d], axis=1)
    inertia = _find_symmetrizer(stiffness, damping)
    unit = np.outer(1.0 / basis.scale, 1.0 / basis.scale)
    inertia *= d / float(np.trace(inertia * unit))
    stiffness, damping = (-0.5 * (inertia @ a + (inertia @ a).T) for a in (stiffness, damping))
    potential = np.zeros(len(order))
    for k, powers in enumerate(order):
        at = np.repeat(np.arange(d), powers)
        if len(at) == 1:
            potential[k] = -(inertia @ force)[at[0], 0]
        elif len(at) == 2:
            potential[k] = stiffness[at[0], at[1]] * (0.5 if at[0] == at[1] else 1.0)
    return MechanicalModel(
        basis=basis,
        width=samples.width,
        rest=rest,
        mass=_pad_rows(inertia * unit, structure.mass),
        damping=_pad_rows(damping * unit, structure.damping),
        potential=potential,
        input_map=_pad_rows((inertia @ gain).T / basis.scale, structure.input_map),
        dry=np.zeros(d),
        drag=np.zeros(d),
    )


def _pad_rows(first: np.ndarray, n: int) -> np.ndarray:
    """Coefficients of ``n`` functions, all zero but those of the constant."""
    return np.concatenate([first[None], np.zeros((n, *first.shape))])[:n]


def _find_symmetrizer(*matrices: np.ndarray) -> Float64[np.ndarray, "d d"]:
    """The positive matrix near the unit one whose products with ``matrices`` are most symmetric."""
    d = len(matrices[0])
    units = np.array([np.eye(d)[[i]].T @ np.eye(d)[[j]] for i in range(d) for j in range(i, d)])
    units = np.maximum(units, units.mT)
    rows = [IDENTIFICATION.symmetrizer_prior * units.reshape(len(units), -1).T]
    for a in matrices:
        product = units @ a / max(float(np.linalg.norm(a)), 1e-300)
        rows.append((product - product.mT).reshape(len(units), -1).T)
    known = np.zeros(d * d * len(rows))
    known[: d * d] = IDENTIFICATION.symmetrizer_prior * np.eye(d).ravel()
    inertia = np.tensordot(np.linalg.lstsq(np.concatenate(rows), known)[0], units, axes=1)
    values, vectors = np.linalg.eigh(inertia)
    return (vectors * np.maximum(values, IDENTIFICATION.min_inertia * values.max())) @ vectors.T
