"""A first model of a sim by linear regression of the weak Euler-Lagrange equations.

Multiplied by a test function and integrated by parts, the equations need velocities only, and are linear in
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
    """A record through the eyes of a basis, and the test functions."""

    basis: Basis
    dataset: Dataset
    q: Float64[np.ndarray, "N d"]
    v: Float64[np.ndarray, "N d"]
    width: Float64[np.ndarray, " d"]
    tests: tuple[tuple[slice, np.ndarray, np.ndarray], ...]
    """Frames, test function times step and its rate times step, window by window."""


def build_weak_form_samples(
    basis: Basis, record: Dataset, q: np.ndarray, v: np.ndarray, *, width_s: float, speed: np.ndarray
) -> WeakFormSamples:
    """Test functions ``(1 - s^2)^4`` of ``width_s``, a quarter of it apart."""
    tests = []
    for start, stop in record.clips:
        time = record.time[start:stop]
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
    return WeakFormSamples(basis, record, q, v, speed, tuple(tests))


def build_regressors(
    samples: WeakFormSamples, form: ModelStructure
) -> tuple[np.ndarray, np.ndarray, list[tuple]]:
    """Weak equations (R, K), the side that is known (R,), and what each column is.

    Rows are test functions times coordinates; ``columns @ coefficients = known``.
    """
    q, v, u, d = samples.q, samples.v, samples.dataset.u, samples.q.shape[1]
    phi, slope = samples.basis.values(q), samples.basis.slopes(q)
    plain, rated, names = [], [], []  # a column is  int psi plain + int psi' rated, each (N, d)

    def add(name: tuple, still: np.ndarray, moving: np.ndarray | None = None) -> None:
        names.append(name)
        plain.append(still)
        rated.append(np.zeros_like(still) if moving is None else moving)

    for k in range(form.mass):
        for i in range(d):
            for j in range(i, d):
                if k == 0 and i == j == d - 1:
                    continue  # given by the trace
                push = np.zeros_like(v)
                push[:, i] += v[:, j]
                energy = v[:, i] * v[:, j] * (0.5 if i == j else 1.0)
                if i != j:
                    push[:, j] += v[:, i]
                if k == 0 and i == j:
                    push[:, d - 1] -= v[:, d - 1]
                    add(("mass", k, i, j), np.zeros_like(v), -push)
                    continue
                add(("mass", k, i, j), -slope[:, k] * energy[:, None], -phi[:, k, None] * push)
    for k in range(1, form.potential):
        add(("potential", k), slope[:, k])
    for k in range(form.damping):
        for i in range(d):
            for j in range(i, d):
                push = np.zeros_like(v)
                push[:, i] += v[:, j]
                if i != j:
                    push[:, j] += v[:, i]
                add(("damping", k, i, j), phi[:, k, None] * push)
    for k in range(form.input_map):
        for c in range(u.shape[1]):
            for i in range(d):
                push = np.zeros_like(v)
                push[:, i] = -phi[:, k] * u[:, c]
                add(("input_map", k, c, i), push)
    for flag, name in ((form.dry, "dry"), (form.drag, "drag")):
        for i in range(d) if flag else ():
            push = np.zeros_like(v)
            push[:, i] = np.tanh(v[:, i] / samples.width[i]) if name == "dry" else np.abs(v[:, i]) * v[:, i]
            add((name, i), push)
    still, moving = np.array(plain), np.array(rated)  # (K, N, d)
    rows = np.array(
        [
            np.einsum("n,knd->dk", psi, still[:, at]) + np.einsum("n,knd->dk", rate, moving[:, at])
            for at, psi, rate in samples.tests
        ]
    )
    known = np.array([np.einsum("n,nd->d", rate, v[at]) for at, _, rate in samples.tests])
    return rows.reshape(-1, len(names)), known.reshape(-1), names


def build_model(
    samples: WeakFormSamples,
    form: ModelStructure,
    coefficients: np.ndarray,
    names: list[tuple],
    rest: np.ndarray,
) -> MechanicalModel:
    """The model with these coefficients."""
    d, n_u = samples.q.shape[1], samples.dataset.u.shape[1]
    fields = {
        "mass": np.zeros((form.mass, d, d)),
        "damping": np.zeros((form.damping, d, d)),
        "potential": np.zeros(form.potential),
        "input_map": np.zeros((form.input_map, n_u, d)),
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
    """Ridge regression in standardised columns."""
    size = np.sqrt(np.mean(rows**2, axis=0)) + 1e-30
    a = rows / size
    gram = a.T @ a / len(a)
    return np.linalg.solve(gram + ridge * np.eye(len(size)), a.T @ known / len(a)) / size
