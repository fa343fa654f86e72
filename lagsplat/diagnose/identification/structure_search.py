"""From recordings of a simulator to its model: which terms it has, and their coefficients.

A linear model comes from weak-form regression and is refined by multiple shooting. Terms are then added step
by step as long as the Bayesian information criterion falls (`search_structure`).

Recordings do not always fix the inertia: a linear mechanism with few inputs moves alike by ``M, C, K, b`` and
by ``A M, A C, A K, A b``, as long as these stay symmetric. Added forces enter by ``M^-1``, however, so that
friction at one coordinate would act on all coordinates of an arbitrary choice. Of equivalent models the one
with the least inertia between coordinates is taken (`decouple_inertia`).
"""

from dataclasses import dataclass, replace
from functools import cached_property

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.core.config import IDENTIFICATION, DiagnoseConfig
from lagsplat.diagnose.estimation.dataset import Dataset, PreparedDataset, WindowSet
from lagsplat.diagnose.estimation.multiple_shooting import (
    GaussianPrior,
    ShootingData,
    ShootingFit,
    choose_windows,
    compute_autocorrelation_time,
    differentiate_predictions,
    eliminate_starts,
    fit_multiple_shooting,
)
from lagsplat.diagnose.estimation.rollout import CoefficientRollout
from lagsplat.diagnose.identification import weak_form
from lagsplat.diagnose.mechanics.basis import Basis
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.mechanics.structure import (
    MAX_FEW_COORDINATES,
    SIZED_FIELDS,
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
class InformationCriterion:
    """What the Bayesian information criterion of a fit is made of.

    Of correlated noise ``correlation`` samples count as one. What the better of two fits leaves is nearer the
    noise, so that two fits are compared at the smaller of their correlations.
    """

    misfit: float  # sum of the squared residuals [noise variances]
    n_data: float  # degrees of freedom of the data
    n_free: int  # coefficients
    correlation: float  # samples of the residual that count as one

    def evaluate(self, correlation: float) -> float:
        """The criterion where so many samples count as one."""
        n = self.n_data / correlation
        # a misfit below half the noise's variance is overfitting and gains nothing
        return n * float(np.log(max(self.misfit / self.n_data, 0.5))) + self.n_free * float(np.log(n))

    def exceed(self, other: "InformationCriterion") -> float:
        """How far the criterion is above that of another fit to the same data."""
        correlation = min(self.correlation, other.correlation)
        return self.evaluate(correlation) - other.evaluate(correlation)


@dataclass(frozen=True)
class StructureFit:
    """A model of a certain structure, refined by multiple shooting."""

    criterion: InformationCriterion
    model: MechanicalModel
    structure: ModelStructure
    fit: ShootingFit
    moves: Float64[np.ndarray, "n K"]  # direction in the space of all coefficients of each unknown of the fit


@dataclass(frozen=True)
class IdentifiedModel:
    """A simulator's model as identified from its recordings."""

    model: MechanicalModel
    structure: ModelStructure
    misfit: float  # mean square residual over the windows, in units of the noise
    uncertainty_directions: Float64[np.ndarray, "R K"]  # changes by one standard deviation, the largest first
    fit: ShootingFit
    windows: WindowSet
    criterion: InformationCriterion


@dataclass(frozen=True)
class IdentificationProblem:
    """The recordings of a simulator, ready for multiple shooting."""

    dataset: Dataset
    windows: WindowSet
    data: ShootingData
    steps: int  # substeps between two frames
    config: DiagnoseConfig

    @cached_property
    def speed(self) -> Float64[np.ndarray, " d"]:
        """Standard deviation of the velocities."""
        return np.std(self.dataset.v, axis=0)

    @property
    def n_data(self) -> float:
        """Degrees of freedom: the number of samples less that of the initial states."""
        w = self.windows
        return float(w.length.sum() * self.dataset.d - 2 * self.dataset.d * len(w.first))

    @property
    def initial_states(self) -> Float64[np.ndarray, "W s"]:
        """Initial states of the windows."""
        return self.windows.initial_states(self.dataset)

    def make_rollout(self, model: MechanicalModel, moves: np.ndarray) -> CoefficientRollout:
        """Rollouts of a model with its coefficients moved along ``moves`` (n, K)."""
        held = self.config.input_hold == "zoh"
        return CoefficientRollout(model, self.dataset, self.windows, moves, self.steps, held)

    def select_windows(self, fit: ShootingFit) -> tuple["IdentificationProblem", ShootingFit]:
        """The problem, and a fit of it, on `IDENTIFICATION.linearised_windows` of its windows, at most."""
        chosen = choose_windows(fit, self.windows.length, IDENTIFICATION.linearised_windows)
        windows = self.windows.select(chosen)
        y, weight = (values[chosen, : windows.longest] for values in (self.data.y, self.data.weight))
        data = ShootingData(y, weight, self.data.start_step)
        return replace(self, windows=windows, data=data), fit.select(chosen, windows.longest)

    def linearise(
        self, model: MechanicalModel, moves: np.ndarray, starts: np.ndarray
    ) -> tuple[Float64[np.ndarray, "n n"], Float64[np.ndarray, " n"]]:
        """Curvature and gradient of half the misfit by ``moves`` (n, K), initial states eliminated."""
        rollout, n = self.make_rollout(model, moves), len(moves)
        linear = differentiate_predictions(rollout, np.zeros(n), starts, self.data, make_weak_prior(n).step)
        left = eliminate_starts(*linear)
        return left.curvature, left.right

    def fit_moves(
        self,
        model: MechanicalModel,
        moves: np.ndarray,
        starts: np.ndarray,
        prior: GaussianPrior,
        *,
        iterations: int,
    ) -> ShootingFit:
        """Fit how far to move a model along ``moves`` (n, K), by shooting from ``starts`` (W, 2 d)."""
        return fit_multiple_shooting(
            self.make_rollout(model, moves),
            np.zeros(len(moves)),
            starts,
            self.data,
            prior,
            iterations=iterations,
            tolerance=IDENTIFICATION.fit_tolerance,
        )

    def compute_misfit(self, model: MechanicalModel) -> float:
        """Misfit of a model when only the windows' initial states are fitted; infinite if it diverges."""
        no_moves = np.zeros((0, flatten_coefficients(model).size))
        fit = self.fit_moves(model, no_moves, self.initial_states, make_weak_prior(0), iterations=4)
        return fit.misfit if np.isfinite(fit.misfit) else np.inf

    def refine(self, model: MechanicalModel, structure: ModelStructure, starts: np.ndarray) -> StructureFit:
        """Refine all free coefficients by multiple shooting."""
        moves = list_free_directions(model, structure, self.speed)
        prior = make_weak_prior(len(moves))
        fit = self.fit_moves(model, moves, starts, prior, iterations=self.config.identify_iterations)
        refined = shift_coefficients(model, fit.x @ moves)
        correlation = compute_autocorrelation_time(fit.residual, self.windows.length)
        criterion = InformationCriterion(fit.misfit, self.n_data, len(moves), correlation)
        return StructureFit(criterion, refined, structure, fit, moves)


def make_weak_prior(n: int) -> GaussianPrior:
    """A wide prior of ``n`` coefficients, which are counted in units of their fields."""
    values = (0.0, IDENTIFICATION.coefficient_deviation, -np.inf, 1e-5)
    return GaussianPrior(*(np.full(n, value) for value in values))


def list_uncertain_directions(
    curvature: Float64[np.ndarray, "n n"], moves: Float64[np.ndarray, "n K"], *, deviation: float
) -> Float64[np.ndarray, "n K"]:
    """Principal axes of the coefficients' posterior, of one standard deviation each, the largest first.

    ``curvature`` is that of the data by a fit's unknowns, ``moves`` are the directions of these and
    ``deviation`` is the prior standard deviation of each.
    """
    return _principal_axes(np.linalg.inv(curvature + np.eye(len(moves)) / deviation**2)) @ moves


def _principal_axes(scatter: Float64[np.ndarray, "n n"]) -> Float64[np.ndarray, "n n"]:
    """Rows: the axes of a covariance, of one standard deviation each, the largest first."""
    values, vectors = np.linalg.eigh(scatter)
    return (vectors * np.sqrt(np.maximum(values, 0.0))).T[::-1]


def predict_criteria(
    problem: IdentificationProblem, best: StructureFit, larger: list[ModelStructure]
) -> list[InformationCriterion]:
    """Predict the criterion of each larger structure, from one linearisation for all, of some windows."""
    sizes = {name: max(getattr(form, name) for form in larger) for name in SIZED_FIELDS}
    union = ModelStructure(**sizes, dry=True, drag=True)
    padded = pad_model(best.model, union)
    moves = list_free_directions(padded, union, problem.speed)
    part, fit = problem.select_windows(best.fit)
    curvature, gradient = part.linearise(padded, moves, fit.starts)
    share = part.windows.length.sum() / problem.windows.length.sum()
    curvature, gradient = curvature / share, gradient / share
    predicted = []
    for structure in larger:
        fixed = ~list_free_directions(padded, structure, problem.speed).any(axis=0)
        kept = np.flatnonzero(~moves[:, fixed].any(axis=1))
        h = curvature[np.ix_(kept, kept)] + np.eye(len(kept)) / IDENTIFICATION.coefficient_deviation**2
        gain = -np.inf  # a diverged rollout foretells nothing
        if np.isfinite(h).all():
            gain = float(gradient[kept] @ np.linalg.lstsq(h, gradient[kept], rcond=1e-12)[0])
        predicted.append(replace(best.criterion, misfit=best.fit.misfit - gain, n_free=len(kept)))
    return predicted


def fit_first_model(
    problem: IdentificationProblem, basis: Basis, n_potential: int, test_s: float
) -> MechanicalModel:
    """A model by weak-form regression with test functions ``test_s`` [s] wide.

    Only the potential, of ``n_potential`` functions, depends on the coordinates.

    Forces are regressed with a weak and with a strong ridge, as noise may leave hardly any inertia in some
    direction, and accelerations; the model with the least misfit is taken. With many coordinates some
    oscillate much faster than others, so that no single test function suits all, and have so little inertia
    that a ridge would outweigh it: several test functions and ridges are then compared.
    """
    ridge, width = problem.config.identify_ridge, 0.02 * problem.speed

    def regress(share: float, *ridges: float) -> list[MechanicalModel]:
        samples = weak_form.build_weak_form_samples(
            basis, n_potential, problem.dataset, width_s=share * test_s, speed=width
        )
        rows, known = weak_form.build_regressors(samples)
        fits = [weak_form.solve_ridge(rows, known, ridge) for ridge in ridges]
        models = [weak_form.build_model(samples, fit) for fit in fits]
        explicit = weak_form.fit_explicit_model(samples, ridge)
        return models if explicit is None else [*models, explicit]

    if problem.dataset.d == 1:
        return regress(1.0, ridge)[0]
    if problem.dataset.d <= MAX_FEW_COORDINATES:
        return min(regress(1.0, ridge, 0.1), key=problem.compute_misfit)
    shares = IDENTIFICATION.test_width_factors
    return min(
        (m for share in shares for m in regress(share, ridge, 1e-3 * ridge)), key=problem.compute_misfit
    )


def search_structure(problem: IdentificationProblem, basis: Basis, test_s: float) -> StructureFit:
    """Grow a linear model by the step with the best predicted criterion, as long as the criterion falls."""
    driven = problem.dataset.u.shape[1] > 0
    structure = ModelStructure(1, 1, list_field_sizes(basis)[2], 1 if driven else 0)
    first = fit_first_model(problem, basis, structure.potential, test_s)
    best = problem.refine(first, structure, problem.initial_states)
    refused, correlation = set[ModelStructure](), best.criterion.correlation
    while True:
        larger = [f for f in list_larger_structures(best.structure, basis, driven=driven) if f not in refused]
        # a residual below the noise leaves nothing to explain
        if not larger or best.fit.misfit < 0.6 * problem.n_data:
            return best
        known = replace(best.criterion, correlation=correlation)
        predicted = zip(predict_criteria(problem, best, larger), larger, strict=True)
        ahead = [(criterion.exceed(known), structure) for criterion, structure in predicted]
        excess, structure = min(ahead, key=lambda row: (row[0], row[1].order))
        if excess > 0.0:
            return best
        candidate = problem.refine(pad_model(best.model, structure), structure, best.fit.starts)
        correlation = min(correlation, candidate.criterion.correlation)
        if candidate.criterion.exceed(known) < 0.0:
            reduction = 1.0 - IDENTIFICATION.min_misfit_reduction
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
    return padded, problem.linearise(padded, moves, best.fit.starts)[0], moves


def build_identification_problem(
    ready: PreparedDataset, windows: WindowSet, config: DiagnoseConfig, *, period_s: float
) -> IdentificationProblem:
    """Windows of the recordings of a simulator of natural period ``period_s``, to be fitted."""
    dataset = ready.dataset
    data = ShootingData.of(dataset, windows, ready.sigma)
    steps = max(1, int(np.ceil(dataset.dt_s * config.steps_per_period / period_s)))
    return IdentificationProblem(dataset, windows, data, steps, config)


def identify_model(problem: IdentificationProblem, *, period_s: float) -> IdentifiedModel:
    """Identify the model of a simulator of natural period ``period_s``."""
    dataset = problem.dataset
    degree = {1: 7, 2: 5}.get(dataset.d, 3)  # of the polynomials; the number of terms grows fast with d
    candidates = []
    for basis in build_candidate_bases(dataset.q, degree=degree):
        candidates.append(search_structure(problem, basis, 0.5 * period_s))
        # down to the noise, no other basis can be better
        if candidates[-1].fit.misfit < 1.1 * problem.n_data:
            break
    correlation = min(candidate.criterion.correlation for candidate in candidates)
    best = min(candidates, key=lambda candidate: candidate.criterion.evaluate(correlation))
    misfit = best.fit.misfit / max(problem.n_data - len(best.moves), 1.0)
    model, curvature, moves = best.model.trim_basis(), best.fit.curvature, best.moves
    if dataset.d <= MAX_FEW_COORDINATES:
        model, curvature, moves = add_unseen_terms(problem, best)
    freedom = list_uncertain_directions(
        curvature / (max(misfit, 1.0) * correlation), moves, deviation=IDENTIFICATION.coefficient_deviation
    )
    decoupled, remaining = decouple_inertia(model, freedom)
    limit = IDENTIFICATION.equivalent_misfit_ratio * max(best.fit.misfit, problem.n_data)
    if decoupled is not model and problem.compute_misfit(decoupled) < limit:
        model, freedom = decoupled, remaining
    return IdentifiedModel(model, best.structure, misfit, freedom, best.fit, problem.windows, best.criterion)


def refit_model(problem: IdentificationProblem, identified: IdentifiedModel) -> IdentifiedModel:
    """The same structure fitted to the windows of another problem; what is uncertain of it stays."""
    padded = pad_model(identified.model, identified.structure)
    again = problem.refine(padded, identified.structure, problem.initial_states)
    misfit = again.criterion.misfit / max(problem.n_data - len(again.moves), 1.0)
    return replace(identified, model=again.model, misfit=misfit, fit=again.fit, windows=problem.windows)


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
    slope = rows[(slice(None), *across)] / (IDENTIFICATION.max_inertia_coupling * size)
    scatter = np.linalg.inv(np.eye(len(freedom)) + slope @ slope.T)
    far = model.mass[0][across] / (IDENTIFICATION.max_inertia_coupling * size)
    decoupled = shift_coefficients(model, -(scatter @ slope @ far) @ freedom)
    if np.linalg.eigvalsh(decoupled.mass[0]).min() <= 0.0:
        return model, freedom
    return decoupled, _principal_axes(scatter) @ freedom
