"""A first model of a simulator by linear regression of the weak form of the Euler-Lagrange equations.

Multiplied by a test function and integrated by parts, the equations need no accelerations and are linear in
every coefficient. The scale of inertia is fixed by ``tr M_0 = d``.

Source: Messenger and Bortz, "Weak SINDy for partial differential equations", doi:10.1016/j.jcp.2021.110525.
"""

from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.core.config import IDENTIFICATION
from lagsplat.diagnose.data_quality.natural_period import compute_test_functions
from lagsplat.diagnose.estimation.dataset import Dataset
from lagsplat.diagnose.mechanics.basis import POWER, Basis
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.mechanics.structure import make_symmetric_basis


@dataclass(frozen=True)
class WeakFormSamples:
    """Samples of the motion in a certain basis, and the test functions."""

    basis: Basis
    n_potential: int  # functions of the potential; all other fields are constant
    dataset: Dataset
    width: Float64[np.ndarray, " d"]  # speed below which dry friction is linear
    tests: tuple[tuple[slice, np.ndarray, np.ndarray], ...]
    """Frames of each test function, and its values and its time derivative there, both times the step [s]."""


def build_weak_form_samples(
    basis: Basis, n_potential: int, dataset: Dataset, *, width_s: float, speed: np.ndarray
) -> WeakFormSamples:
    """Place test functions ``(1 - s^2)^4``, ``width_s`` [s] wide, on all clips, a quarter of that apart.

    ``n_potential`` is the number of functions of the potential, ``speed`` (d,) is that below which dry
    friction is linear.
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
            value, rate, _ = compute_test_functions(np.clip(s, -1.0, 1.0), half)
            tests.append(
                (slice(start + first, start + last), value * step[first:last], rate * step[first:last])
            )
    return WeakFormSamples(basis, n_potential, dataset, speed, tuple(tests))


def build_regressors(samples: WeakFormSamples) -> tuple[np.ndarray, np.ndarray]:
    """The linear equations of the coefficients: ``rows`` (R, K), one a test function and coordinate, and what
    ``rows @ coefficients`` must be (R,).

    The coefficients are those of inertia, potential, damping and inputs, as `build_model` takes them.
    """
    v, u, d = samples.dataset.v, samples.dataset.u, samples.dataset.d
    slope = samples.basis.slopes(samples.dataset.smooth)[:, 1 : samples.n_potential]
    losses = np.einsum("pij,nj->pni", make_symmetric_basis(d), v)
    drive = -np.einsum("nc,ij->cinj", u, np.eye(d)).reshape(-1, *v.shape)
    # a column is  int psi force + int psi' momentum, each (N, d)
    momenta = -np.einsum("pij,nj->pni", _list_free_inertias(d), v)
    forces = np.concatenate([slope.transpose(1, 0, 2), losses, drive])
    rows, known = [], []
    for frames, value, rate in samples.tests:
        parts = [(rate, momenta), (value, forces)]
        columns = [np.einsum("n,knd->dk", weight, part[:, frames]) for weight, part in parts]
        rows.append(np.concatenate(columns, axis=1))
        known.append(np.einsum("n,nd->d", rate, v[frames]))
    return np.array(rows).reshape(-1, len(momenta) + len(forces)), np.array(known).reshape(-1)


def _list_free_inertias(d: int) -> Float64[np.ndarray, "P d d"]:
    """Changes of a symmetric matrix that keep its trace: the last of the diagonal makes up for the others."""
    pairs = make_symmetric_basis(d)
    return (pairs - np.trace(pairs, axis1=1, axis2=2)[:, None, None] * pairs[-1])[:-1]


def build_model(samples: WeakFormSamples, coefficients: Float64[np.ndarray, " K"]) -> MechanicalModel:
    """The model with the coefficients of a regression."""
    d, inertias = samples.dataset.d, _list_free_inertias(samples.dataset.d)
    pairs = make_symmetric_basis(d)
    ends = np.cumsum([len(inertias), samples.n_potential - 1, len(pairs)])
    mass, potential, damping, gain = np.split(coefficients, ends)
    inertia, potential = np.eye(d) + np.tensordot(mass, inertias, 1), np.append(0.0, potential)
    return _make_linear_model(
        samples, inertia, np.tensordot(damping, pairs, 1), potential, gain.reshape(-1, d)
    )


def _make_linear_model(
    samples: WeakFormSamples,
    inertia: Float64[np.ndarray, "d d"],
    damping: Float64[np.ndarray, "d d"],
    potential: Float64[np.ndarray, " Kv"],
    gain: Float64[np.ndarray, "n_u d"],
) -> MechanicalModel:
    """A model whose inertia, damping and inputs do not depend on the coordinates, without friction."""
    none, rest = np.zeros(len(inertia)), np.median(samples.dataset.q, axis=0)
    fields = (inertia[None], damping[None], potential, gain[None, :][: len(gain)])
    return MechanicalModel(samples.basis, *fields, dry=none, drag=none, width=samples.width, rest=rest)


def solve_ridge(rows: np.ndarray, known: np.ndarray, ridge: float) -> Float64[np.ndarray, " K"]:
    """Ridge regression of ``known`` (R,) on the standardised columns of ``rows`` (R, K)."""
    size = np.sqrt(np.mean(rows**2, axis=0)) + 1e-30
    a = rows / size
    gram = a.T @ a / len(a)
    return np.linalg.solve(gram + ridge * np.eye(len(size)), a.T @ known / len(a)) / size


def fit_explicit_model(samples: WeakFormSamples, ridge: float) -> MechanicalModel | None:
    """A linear model from the regression of the accelerations, instead of the forces.

    Where coordinates move together, as a cart and the pole that swings on it, the regression of forces may
    find one equation twice, with hardly any inertia across it. Accelerations are never trivial so. Of all
    symmetric inertias the one is taken that makes stiffness and damping most nearly symmetric.

    Returns:
        None where the potential is not a quadratic one.
    """
    basis, u, d = samples.basis, samples.dataset.u, samples.dataset.d
    order = basis.order[: samples.n_potential]
    if (basis.kind[: len(order)] != POWER).any() or order.sum(axis=1).max() != 2:
        return None
    x, rate = (samples.dataset.smooth - basis.centre) / basis.scale, samples.dataset.v / basis.scale
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
    return _make_linear_model(
        samples, inertia * unit, damping * unit, potential, (inertia @ gain).T / basis.scale
    )


def _find_symmetrizer(*matrices: np.ndarray) -> Float64[np.ndarray, "d d"]:
    """The positive matrix near the unit one whose products with ``matrices`` are most symmetric."""
    d = len(matrices[0])
    units = make_symmetric_basis(d)
    rows = [IDENTIFICATION.symmetrizer_prior * units.reshape(len(units), -1).T]
    for a in matrices:
        product = units @ a / max(float(np.linalg.norm(a)), 1e-300)
        rows.append((product - product.mT).reshape(len(units), -1).T)
    known = np.zeros(d * d * len(rows))
    known[: d * d] = IDENTIFICATION.symmetrizer_prior * np.eye(d).ravel()
    inertia = np.tensordot(np.linalg.lstsq(np.concatenate(rows), known)[0], units, axes=1)
    values, vectors = np.linalg.eigh(inertia)
    return (vectors * np.maximum(values, IDENTIFICATION.min_inertia * values.max())) @ vectors.T
