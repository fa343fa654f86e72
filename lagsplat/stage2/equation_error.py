"""Start of a polynomial law: linear least squares on the balance of forces along the smoothed trajectory.

``M a + C w + grad V(q) - u.grad nu(q) = 0`` is linear in constant ``M`` and ``C`` and in the coefficients of
the polynomials. The stiffness is normalised instead of the mass, and errors are measured as displacements,
which is to say weighted by the inverse of the loaded stiffness: noise of the accelerations then counts little
in stiff directions, and a motion that only follows its inputs still gives the law's static part.
"""

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.array_types import Series
from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2.config import FormConfig
from lagsplat.stage2.lagrangian import SOFT_LIMIT, Coefficients, Floors, Lagrangian
from lagsplat.stage2.polynomials import evaluate_monomials, list_exponents

# The numbers below were set by hand, with the simulated arm of one segment in view.
MOST_STATES = 3000
ROUNDS = 3  # of least squares, each with the weight of the one before
RIDGE = 1e-6  # relative to the mean square of each column
LEAST_EIGENVALUE = 0.01  # of M and C, relative to their largest
MARGIN = 4  # frames at either end of a segment, where a spline is not determined from both sides
MASS_FLOOR, DAMPING_FLOOR = 3e-3, 1e-4  # of the mean eigenvalue at the start

Matrix = Float64[np.ndarray, "d d"]
Columns = Float64[np.ndarray, "T k d"]


def fit_equation_error(
    trajectory: EncodedTrajectory, form: FormConfig, *, time_unit_s: float, seed: int
) -> Lagrangian:
    """Fit a polynomial law to the accelerations of a smoothed trajectory, with inputs as measured.

    A smoothed input would look like inertia: a Gaussian of one frame adds half a squared frame to ``M / K``.

    Args:
        trajectory: smoothed states, and inputs that are not smoothed.
        form: degrees of the polynomials; mass and damping are constant in this fit.
        time_unit_s: internal unit of time of the law [s].
        seed: of the law, which has no random weights where it is polynomial.

    Raises:
        ValueError: no segment is long enough for accelerations.

    Source: Aguirre and Letellier 2009, "Modeling nonlinear dynamics and chaos: a review" (equation error).
    """
    q, v, a, u = _differentiate(trajectory, time_unit_s)
    d, n_inputs = q.shape[1], u.shape[1]
    exponents = list_exponents(d, lowest=1, highest=form.potential_degree)
    input_exponents = list_exponents(d, lowest=1, highest=form.input_degree)
    potential, volume = (_gradients(q, x) for x in (exponents, input_exponents))
    squares = [exponents.tolist().index([2.0 * (i == j) for i in range(d)]) for j in range(d)]
    # the coefficients of the squares sum to d
    potential_columns = potential.copy()
    potential_columns[:, squares[1:]] -= potential[:, squares[:1]]
    kept = np.delete(potential_columns, squares[0], axis=1)
    inputs = -(u[:, :, None, None] * volume[:, None]).reshape(len(q), -1, d)
    columns = np.concatenate([kept, inputs, _symmetric(a), _symmetric(v)], axis=1)
    target = -d * potential[:, squares[0]]
    weight = np.eye(d)
    for _ in range(ROUNDS):
        x = _solve(columns, target, weight)
        sizes = np.cumsum([kept.shape[1], inputs.shape[1], d * (d + 1) // 2])
        elastic, pushed, inertia, viscous = np.split(x, sizes)
        elastic = np.insert(elastic, squares[0], d - elastic[[k - 1 for k in squares[1:]]].sum())
        pushed = pushed.reshape(n_inputs, len(input_exponents))
        stiffness = _mean_stiffness(q, u, elastic, pushed, exponents, input_exponents)
        weight = np.linalg.inv(_positive(stiffness))
    mass, damping = (_positive(_unpack(part, d)) for part in (inertia, viscous))
    floors = Floors(MASS_FLOOR * np.trace(mass) / d, DAMPING_FLOOR * np.trace(damping) / d, 0.0)
    two = 2.0 * torch.eye(d, dtype=torch.float64)
    none = torch.zeros(n_inputs, d, dtype=torch.float64)
    start = Coefficients(torch.from_numpy(mass), torch.from_numpy(damping), two, none, 0.0 * two[0])
    lagrangian = Lagrangian(start, form=form, floors=floors, time_unit_s=time_unit_s, seed=seed)
    assert lagrangian.energy is not None
    with torch.no_grad():
        lagrangian.energy.coefficients.copy_(torch.from_numpy(elastic))
        lagrangian.energy.coefficients[squares] -= 0.5 * lagrangian.energy.ridge
        lagrangian.energy.input_coefficients.copy_(torch.from_numpy(pushed))
    return lagrangian


def _differentiate(
    trajectory: EncodedTrajectory, time_unit_s: float
) -> tuple[Series, Series, Series, Series]:
    """States, velocities and accelerations in internal units, and inputs, at evenly spread frames."""
    v = time_unit_s * trajectory.differentiate(1)
    a = time_unit_s**2 * trajectory.differentiate(2)
    inner = [np.arange(a + MARGIN, b - MARGIN) for a, b in trajectory.segments if b - a > 2 * MARGIN]
    if not inner:
        longest = max((stop - start for start, stop in trajectory.segments), default=0)
        raise ValueError(
            f"the longest training segment has {longest} frames, and accelerations need more than "
            f"{2 * MARGIN}: record longer clips"
        )
    frames = np.concatenate(inner)
    frames = frames[:: max(1, len(frames) // MOST_STATES)]
    return trajectory.latents[frames], v[frames], a[frames], trajectory.inputs[frames]


def _gradients(q: Series, exponents: torch.Tensor) -> Columns:
    return evaluate_monomials(torch.from_numpy(q), exponents, reach=SOFT_LIMIT)[1].numpy()


def _symmetric(x: Series) -> Columns:
    """Columns of ``S x`` for the lower triangle of a symmetric ``S``, row by row."""
    d = x.shape[1]
    columns = []
    for i in range(d):
        for j in range(i + 1):
            column = np.zeros_like(x)
            column[:, i] = x[:, j]
            column[:, j] = x[:, i]
            columns.append(column)
    return np.stack(columns, axis=1)


def _unpack(triangle: np.ndarray, d: int) -> Matrix:
    matrix = np.zeros((d, d))
    matrix[np.tril_indices(d)] = triangle
    return matrix + np.tril(matrix, -1).T


def _positive(matrix: Matrix) -> Matrix:
    """The matrix with its eigenvalues raised to a share of the largest one."""
    values, vectors = np.linalg.eigh(0.5 * (matrix + matrix.T))
    largest = np.abs(values).max()
    return (vectors * np.maximum(values, LEAST_EIGENVALUE * largest)) @ vectors.T


def _solve(columns: Columns, target: Series, weight: Matrix) -> np.ndarray:
    """Weighted least squares with a small ridge on columns of unit size."""
    design = np.einsum("ij,tkj->tik", weight, columns).reshape(-1, columns.shape[1])
    aim = (target @ weight.T).ravel()
    scale = np.sqrt(np.mean(design**2, axis=0)) + 1e-12
    damped = np.vstack([design / scale, np.sqrt(RIDGE * len(target)) * np.eye(len(scale))])
    return np.linalg.lstsq(damped, np.concatenate([aim, np.zeros(len(scale))]), rcond=None)[0] / scale


def _mean_stiffness(
    q: Series,
    u: Series,
    elastic: np.ndarray,
    pushed: np.ndarray,
    exponents: torch.Tensor,
    input_exponents: torch.Tensor,
) -> Matrix:
    """Mean over states of the Hessian of ``V - u.nu``, by central differences."""
    some = np.unique(np.linspace(0, len(q) - 1, 400).astype(int))
    q, u = q[some], u[some]

    def slope(x: Series) -> Series:
        return np.einsum("k,tkd->td", elastic, _gradients(x, exponents)) - np.einsum(
            "tk,tkd->td", u @ pushed, _gradients(x, input_exponents)
        )

    return np.stack([_central(slope, q, i) for i in range(q.shape[1])], axis=1)


def _central(slope: Callable[[Series], Series], q: Series, i: int) -> np.ndarray:
    step = 1e-4 * np.eye(q.shape[1])[i]
    return np.mean(slope(q + step) - slope(q - step), axis=0) / 2e-4
