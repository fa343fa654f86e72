"""From recordings of a simulator to its model: which terms it has, and their coefficients.

A linear model comes from weak-form regression and is refined by multiple shooting. Terms are then added step
by step as long as the Bayesian information criterion falls (`search_structure`).

Recordings do not always fix the inertia: a linear mechanism with few inputs moves alike by ``M, C, K, b`` and
by ``A M, A C, A K, A b``, as long as these stay symmetric. Added forces enter by ``M^-1``, however, so that
friction at one coordinate would act on all coordinates of an arbitrary choice. Of equivalent models the one
with the least inertia between coordinates is taken (`decouple_inertia`).
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.core.config import STRUCTURE_SEARCH
from lagsplat.diagnose.estimation.dataset import Dataset, WindowSet
from lagsplat.diagnose.estimation.multiple_shooting import (
    GaussianPrior,
    ShootingData,
    ShootingFit,
    eliminate_starts,
    fit_multiple_shooting,
)
from lagsplat.diagnose.estimation.rollout import ParameterSensitivity
from lagsplat.diagnose.identification.weak_form import (
    build_model,
    build_regressors,
    build_weak_form_samples,
    solve_ridge,
)
from lagsplat.diagnose.mechanics.basis import Basis
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.mechanics.structure import (
    COEFFICIENT_FIELDS,
    MAX_FEW_COORDINATES,
    ModelStructure,
    build_candidate_bases,
    flatten_coefficients,
    list_field_sizes,
    list_free_directions,
    list_larger_structures,
    pad_model,
    shift_coefficients,
)


@dataclass(frozen=True)
class IdentifiedModel:
    """A simulator's model as identified from its recordings."""

    model: MechanicalModel
    structure: ModelStructure
    misfit: float  # mean square residual over the windows, in units of the noise
    uncertainty_directions: Float64[np.ndarray, "R K"]
    """Changes of all coefficients, each of one standard deviation, the largest first."""
    fit: ShootingFit
    windows: WindowSet
    bic: float  # Bayesian information criterion


@dataclass(frozen=True)
class IdentificationSettings:
    """How a simulator is identified, from ``conf/diagnose``."""

    steps_per_period: float  # Runge-Kutta steps in a natural period at least
    ridge: float  # penalty of the weak-form regression in standardised columns
    iterations: int  # steps of each fit at most
    tolerance: float  # relative gain of a step below which a fit has converged
    test_s: float = 0.0  # width of a test function [s]


@dataclass(frozen=True)
class IdentificationProblem:
    """The recordings of a simulator, ready for multiple shooting."""

    dataset: Dataset
    smooth: Float64[np.ndarray, "N d"]  # smoothed coordinates
    speed: Float64[np.ndarray, " d"]  # standard deviation of the velocities
    windows: WindowSet
    data: ShootingData
    steps: int  # substeps between two frames
    held: bool  # inputs are held between samples (zero-order hold) instead of interpolated
    setting: IdentificationSettings

    @property
    def n_data(self) -> float:
        """Degrees of freedom: the number of samples less that of the initial states."""
        w = self.windows
        return float(w.length.sum() * self.dataset.d - 2 * self.dataset.d * len(w.first))

    def make_sensitivity(self, model: MechanicalModel, moves: np.ndarray) -> ParameterSensitivity:
        """Rollouts of a model with its coefficients moved along ``moves``."""
        return ParameterSensitivity(
            model, self.dataset, self.windows, moves, self.smooth, self.steps, self.held
        )

    def fit_moves(
        self,
        model: MechanicalModel,
        moves: np.ndarray,
        starts: np.ndarray,
        prior: GaussianPrior,
        *,
        iterations: int,
    ) -> ShootingFit:
        """Fit how far to move a model along ``moves``, by multiple shooting.

        Args:
            model: the model to move.
            moves: directions in the space of all coefficients (n, K).
            starts: initial states to begin with (W, 2 d).
            prior: prior of the n unknowns.
            iterations: steps at most.
        """
        sensitivity = self.make_sensitivity(model, moves)
        return fit_multiple_shooting(
            sensitivity,
            np.zeros(len(moves)),
            starts,
            self.data,
            prior,
            iterations=iterations,
            tolerance=self.setting.tolerance,
            exact=sensitivity.derivatives,
        )

    @property
    def initial_states(self) -> Float64[np.ndarray, "W s"]:
        """Initial states of the windows by the smoothed coordinates and estimated velocities."""
        return np.concatenate([self.smooth, self.dataset.v], axis=1)[self.windows.first]

    def compute_misfit(self, model: MechanicalModel) -> float:
        """Misfit of a model when only the windows' initial states are fitted; infinite if it diverges."""
        no_moves = np.zeros((0, flatten_coefficients(model).size))
        fit = self.fit_moves(model, no_moves, self.initial_states, make_weak_prior(0), iterations=4)
        return fit.misfit if np.isfinite(fit.misfit) else np.inf

    def refine(
        self, model: MechanicalModel, structure: ModelStructure, starts: np.ndarray
    ) -> tuple[MechanicalModel, ShootingFit, np.ndarray]:
        """Refine all free coefficients by multiple shooting.

        Returns:
            The refined model, the fit, and the direction of each of its unknowns (n, K).
        """
        moves = list_free_directions(model, structure, self.speed)
        fit = self.fit_moves(
            model, moves, starts, make_weak_prior(len(moves)), iterations=self.setting.iterations
        )
        return shift_coefficients(model, fit.x @ moves), fit, moves


def make_weak_prior(n: int) -> GaussianPrior:
    """A wide prior of ``n`` coefficients, which are counted in units of their fields."""
    return GaussianPrior(
        np.zeros(n), np.full(n, STRUCTURE_SEARCH.coefficient_deviation), np.full(n, -np.inf), np.full(n, 1e-5)
    )


def list_uncertain_directions(
    curvature: Float64[np.ndarray, "n n"], moves: Float64[np.ndarray, "n K"], *, deviation: float
) -> Float64[np.ndarray, "n K"]:
    """Principal axes of the coefficients' posterior, of one standard deviation each, the largest first.

    ``curvature`` is that of the data by a fit's unknowns, ``moves`` are the directions of these and
    ``deviation`` is the prior standard deviation of each.
    """
    scatter = np.linalg.inv(curvature + np.eye(len(moves)) / deviation**2)
    values, vectors = np.linalg.eigh(scatter)
    return (vectors * np.sqrt(np.maximum(values, 0.0))).T[::-1] @ moves


@dataclass(frozen=True)
class PredictedGain:
    """A larger structure and its predicted benefit."""

    gain: float  # reduction of the misfit, to first order
    structure: ModelStructure
    n: int  # number of free coefficients


def predict_gains(
    problem: IdentificationProblem,
    model: MechanicalModel,
    larger: list[ModelStructure],
    fit: ShootingFit,
) -> list[PredictedGain]:
    """Predict the gain of each larger structure, from a single linearisation for all."""
    union = ModelStructure(
        mass=max(f.mass for f in larger),
        damping=max(f.damping for f in larger),
        potential=max(f.potential for f in larger),
        input_map=max(f.input_map for f in larger),
        dry=True,
        drag=True,
    )
    padded = pad_model(model, union)
    moves = list_free_directions(padded, union, problem.speed)
    linear = problem.make_sensitivity(padded, moves).derivatives(
        np.zeros(len(moves)), fit.starts, problem.data
    )
    curvature, gradient, *_ = eliminate_starts(*linear)
    gains = []
    for candidate in larger:
        small = pad_model(model, candidate)
        free = list_free_directions(small, candidate, problem.speed)
        kept = np.flatnonzero(_find_moves_within(padded, moves, small, free))
        h = curvature[np.ix_(kept, kept)] + np.eye(len(kept)) / STRUCTURE_SEARCH.coefficient_deviation**2
        gain = float(gradient[kept] @ np.linalg.lstsq(h, gradient[kept], rcond=1e-12)[0])
        gains.append(PredictedGain(gain, candidate, len(kept)))
    return gains


def _find_moves_within(
    large: MechanicalModel, moves: np.ndarray, small: MechanicalModel, free: np.ndarray
) -> np.ndarray:
    """Which ``moves`` of the large model change only coefficients that ``free`` moves of the small one do."""
    allowed = np.zeros(moves.shape[1], dtype=bool)
    at, at_small = 0, 0
    changed = (free != 0.0).any(axis=0)
    for name in COEFFICIENT_FIELDS:
        size, size_small = getattr(large, name).size, getattr(small, name).size
        allowed[at : at + size_small] = changed[at_small : at_small + size_small]
        at, at_small = at + size, at_small + size_small
    return np.array([allowed[row != 0.0].all() for row in moves])


def fit_first_model(
    problem: IdentificationProblem, basis: Basis, structure: ModelStructure, width: np.ndarray
) -> MechanicalModel:
    """A model of a given structure by weak-form regression.

    With many coordinates some oscillate much faster than others, so that no single test function suits all,
    and have so little inertia that a ridge would outweigh it: models by several test functions and ridges
    are then compared by their misfit.
    """
    dataset, rest = problem.dataset, np.median(problem.dataset.q, axis=0)

    def regress(share: float, *ridges: float) -> list[MechanicalModel]:
        test_s = share * problem.setting.test_s
        samples = build_weak_form_samples(
            basis, dataset, problem.smooth, dataset.v, width_s=test_s, speed=width
        )
        rows, known, names = build_regressors(samples, structure)
        return [
            build_model(samples, structure, solve_ridge(rows, known, ridge), names, rest) for ridge in ridges
        ]

    ridge = problem.setting.ridge
    if problem.dataset.d > MAX_FEW_COORDINATES:
        return min(
            (m for share in STRUCTURE_SEARCH.test_width_factors for m in regress(share, ridge, 1e-3 * ridge)),
            key=problem.compute_misfit,
        )
    model, damped = regress(1.0, ridge, 0.1)
    # noise may leave hardly any inertia in some direction, so that rollouts diverge: a strong ridge helps
    return model if np.linalg.eigvalsh(model.mass[0]).min() >= 0.05 else damped


@dataclass(frozen=True)
class StructureFit:
    """A model of a certain structure, refined by multiple shooting."""

    bic: float  # Bayesian information criterion
    model: MechanicalModel
    structure: ModelStructure
    fit: ShootingFit
    moves: Float64[np.ndarray, "n K"]  # direction in the space of all coefficients of each unknown of the fit


def search_structure(
    problem: IdentificationProblem, basis: Basis, *, driven: bool, width: np.ndarray
) -> StructureFit:
    """Grow a linear model by the step with the best predicted criterion, as long as the criterion falls."""

    def criterion(misfit: float, n: int) -> float:
        # a misfit below half the noise's variance is overfitting and gains nothing
        return problem.n_data * np.log(max(misfit / problem.n_data, 0.5)) + n * np.log(problem.n_data)

    def refine(model: MechanicalModel, structure: ModelStructure, starts: np.ndarray) -> StructureFit:
        model, fit, moves = problem.refine(model, structure, starts)
        return StructureFit(criterion(fit.misfit, len(moves)), model, structure, fit, moves)

    structure = ModelStructure(1, 1, list_field_sizes(basis)[2], 1 if driven else 0)
    best = refine(fit_first_model(problem, basis, structure, width), structure, problem.initial_states)
    refused = set[ModelStructure]()
    while True:
        larger = [f for f in list_larger_structures(best.structure, basis, driven=driven) if f not in refused]
        # a residual below the noise leaves nothing to explain
        if not larger or best.fit.misfit < 0.6 * problem.n_data:
            return best
        predicted = [
            (
                criterion(best.fit.misfit - candidate.gain, candidate.n),
                candidate.structure.order,
                candidate.structure,
            )
            for candidate in predict_gains(problem, best.model, larger, best.fit)
        ]
        bic, _, structure = min(predicted, key=lambda row: row[:2])
        if bic > best.bic:
            return best
        candidate = refine(pad_model(best.model, structure), structure, best.fit.starts)
        if candidate.bic < best.bic:
            reduction = 1.0 - STRUCTURE_SEARCH.min_misfit_reduction
            worthwhile = candidate.fit.misfit < reduction * best.fit.misfit
            best = candidate
            if problem.dataset.d > MAX_FEW_COORDINATES and not worthwhile:
                return best
            refused.clear()
        else:
            refused.add(structure)


def add_unseen_terms(
    problem: IdentificationProblem, best: StructureFit
) -> tuple[MechanicalModel, np.ndarray, np.ndarray]:
    """The model with zeros for the next terms of its potential, and the curvature and moves with these.

    The recordings did not require them: they are small within the recorded range, but unknown beyond it. A
    motion that goes further must not find the model certain there.
    """
    sizes = [size for size in list_field_sizes(best.model.basis) if size > best.structure.potential][:2]
    wider = replace(best.structure, potential=sizes[-1]) if sizes else best.structure
    padded = pad_model(best.model, wider).trim_basis()
    moves = list_free_directions(padded, wider, problem.speed)
    sensitivity = problem.make_sensitivity(padded, moves)
    linear = sensitivity.derivatives(np.zeros(len(moves)), best.fit.starts, problem.data)
    return padded, eliminate_starts(*linear)[0], moves


def identify_model(
    dataset: Dataset,
    smooth: Float64[np.ndarray, "N d"],
    sigma: Float64[np.ndarray, " d"],
    period_s: float,
    setting: IdentificationSettings,
    windows: WindowSet,
    *,
    held: bool,
) -> IdentifiedModel:
    """Identify the model of a simulator from ``windows`` of its recordings.

    Args:
        dataset: the recordings.
        smooth: their smoothed coordinates.
        sigma: standard deviation of the measurement noise.
        period_s: natural period [s].
        setting: numbers of the search.
        windows: frames that are fitted.
        held: inputs are held between samples (zero-order hold) instead of interpolated.
    """
    data = ShootingData(
        windows.take(dataset.q),
        windows.mask()[..., None] / sigma,
        1e-4 * np.concatenate([np.std(dataset.q, axis=0), np.std(dataset.v, axis=0)]),
    )
    steps = max(1, int(np.ceil(dataset.dt_s * setting.steps_per_period / period_s)))
    speed = np.std(dataset.v, axis=0)
    problem = IdentificationProblem(
        dataset, smooth, speed, windows, data, steps, held, replace(setting, test_s=0.5 * period_s)
    )
    driven = dataset.u.shape[1] > 0
    degree = {1: 7, 2: 5}.get(dataset.d, 3)  # of the polynomials; the number of terms grows fast with d
    candidates = []
    for basis in build_candidate_bases(dataset.q, degree=degree):
        candidates.append(search_structure(problem, basis, driven=driven, width=0.02 * speed))
        # down to the noise, no other basis can be better
        if candidates[-1].fit.misfit < 1.1 * problem.n_data:
            break
    best = min(candidates, key=lambda candidate: candidate.bic)
    misfit = best.fit.misfit / max(problem.n_data - len(best.moves), 1.0)
    model, curvature, moves = best.model.trim_basis(), best.fit.curvature, best.moves
    if dataset.d <= MAX_FEW_COORDINATES:
        model, curvature, moves = add_unseen_terms(problem, best)
    freedom = list_uncertain_directions(
        curvature / max(misfit, 1.0), moves, deviation=STRUCTURE_SEARCH.coefficient_deviation
    )
    decoupled, remaining = decouple_inertia(model, freedom)
    limit = STRUCTURE_SEARCH.equivalent_misfit_ratio * max(best.fit.misfit, problem.n_data)
    if decoupled is not model and problem.compute_misfit(decoupled) < limit:
        model, freedom = decoupled, remaining
    return IdentifiedModel(model, best.structure, misfit, freedom, best.fit, windows, best.bic)


def decouple_inertia(
    model: MechanicalModel, freedom: Float64[np.ndarray, "R K"]
) -> tuple[MechanicalModel, Float64[np.ndarray, "R K"]]:
    """The equivalent model with the least inertia between coordinates, and what is then still uncertain.

    An inertia that depends on the coordinates stays as it is, because the motion determines it.
    """
    if model.d == 1 or len(model.mass) > 1 or not len(freedom):
        return model, freedom
    at, across = np.diag_indices(model.d), np.triu_indices(model.d, 1)
    size = np.sqrt(np.outer(model.mass[0][at], model.mass[0][at]))[across]
    rows = freedom[:, : model.mass.size].reshape(-1, model.d, model.d)
    slope = rows[(slice(None), *across)] / (STRUCTURE_SEARCH.max_inertia_coupling * size)
    scatter = np.linalg.inv(np.eye(len(freedom)) + slope @ slope.T)
    far = model.mass[0][across] / (STRUCTURE_SEARCH.max_inertia_coupling * size)
    decoupled = shift_coefficients(model, -(scatter @ slope @ far) @ freedom)
    if np.linalg.eigvalsh(decoupled.mass[0]).min() <= 0.0:
        return model, freedom
    values, vectors = np.linalg.eigh(scatter)
    return decoupled, (vectors * np.sqrt(np.maximum(values, 0.0))).T[::-1] @ freedom
