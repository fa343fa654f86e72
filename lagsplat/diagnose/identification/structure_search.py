"""Of the laws that tell a motion alike, the one whose coordinates have an inertia each of their own.

A linear mechanism under few inputs moves alike by ``M, C, K, b`` and by ``A M, A C, A K, A b``, as long as
these stay symmetric: no recording of it tells which. Added forces enter by ``M^-1``, however, so that
friction or a spring at one coordinate would be none at any coordinate of a law that was picked by chance.

From recordings of a simulator to its model: structure by weak regression, coefficients by shooting.
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
    list_field_sizes,
    list_free_directions,
    list_larger_structures,
    pad_model,
    shift_coefficients,
)


def decouple_inertia(
    model: MechanicalModel, freedom: Float64[np.ndarray, "R K"]
) -> tuple[MechanicalModel, Float64[np.ndarray, "R K"]]:
    """The model moved within what its recordings leave open, and what is open then.

    ``uncertainty_directions`` are changes of all coefficients of one standard deviation each. An inertia that
    depends on the coordinates is not moved, for the motion tells it.
    """
    if model.d == 1 or len(model.mass) > 1 or not len(freedom):
        return model, freedom
    at, across = np.diag_indices(model.d), np.triu_indices(model.d, 1)
    size = np.sqrt(np.outer(model.mass[0][at], model.mass[0][at]))[across]
    rows = freedom[:, : model.mass.size].reshape(-1, model.d, model.d)
    slope = rows[(slice(None), *across)] / (STRUCTURE_SEARCH.max_inertia_coupling * size)
    scatter = np.linalg.inv(np.eye(len(freedom)) + slope @ slope.T)
    far = model.mass[0][across] / (STRUCTURE_SEARCH.max_inertia_coupling * size)
    apart = shift_coefficients(model, -(scatter @ slope @ far) @ freedom)
    if np.linalg.eigvalsh(apart.mass[0]).min() <= 0.0:
        return model, freedom
    values, vectors = np.linalg.eigh(scatter)
    return apart, (vectors * np.sqrt(np.maximum(values, 0.0))).T[::-1] @ freedom


@dataclass(frozen=True)
class IdentifiedModel:
    """A model, how well it tells the sim's own recordings, and what they leave open."""

    model: MechanicalModel
    form: ModelStructure
    misfit: float
    """Mean square of the residual over its own windows, in units of the noise."""
    uncertainty_directions: Float64[np.ndarray, "R K"]
    """Changes of all coefficients of one standard deviation each, the largest first."""
    fit: ShootingFit
    windows: WindowSet
    cost: float
    """Bayesian information criterion."""


@dataclass(frozen=True)
class IdentificationSettings:
    """How a sim is identified: what `conf/diagnose` says of it."""

    steps_per_period: float
    ridge: float
    iterations: int
    tolerance: float
    test_s: float = 0.0


@dataclass(frozen=True)
class IdentificationProblem:
    """The recordings of a sim, ready for shooting."""

    dataset: Dataset
    smooth: Float64[np.ndarray, "N d"]
    speed: Float64[np.ndarray, " d"]
    windows: WindowSet
    data: ShootingData
    steps: int
    held: bool
    setting: IdentificationSettings

    @property
    def n_data(self) -> float:
        """Number of samples less what the starts take."""
        w = self.windows
        return float(w.length.sum() * self.dataset.d - 2 * self.dataset.d * len(w.first))

    def make_sensitivity(self, model: MechanicalModel, moves: np.ndarray) -> ParameterSensitivity:
        """Rollouts for changes of a model along ``moves``."""
        return ParameterSensitivity(
            model, self.dataset, self.windows, moves, self.smooth, self.steps, self.held
        )

    def fit_moves(
        self,
        model: MechanicalModel,
        moves: np.ndarray,
        starts: np.ndarray,
        belief: GaussianPrior,
        *,
        iterations: int,
    ) -> ShootingFit:
        """How far to go along ``moves``, by shooting."""
        moving = self.make_sensitivity(model, moves)
        return fit_multiple_shooting(
            moving, np.zeros(len(moves)), starts, self.data, belief,
            iterations=iterations, tolerance=self.setting.tolerance, exact=moving.derivatives,
        )  # fmt: skip

    @property
    def initial_states(self) -> Float64[np.ndarray, "W s"]:
        """Where the windows start by the smoothed record."""
        return np.concatenate([self.smooth, self.dataset.v], axis=1)[self.windows.first]

    def compute_misfit(self, model: MechanicalModel) -> float:
        """Misfit of a model where only the starts of the windows are fitted."""
        nothing = np.zeros((0, sum(getattr(model, name).size for name in COEFFICIENT_FIELDS)))
        fit = self.fit_moves(model, nothing, self.initial_states, make_weak_prior(0), iterations=4)
        return fit.misfit if np.isfinite(fit.misfit) else np.inf

    def refine(
        self, model: MechanicalModel, form: ModelStructure, starts: np.ndarray
    ) -> tuple[MechanicalModel, ShootingFit, np.ndarray]:
        """Coefficients by shooting; the fit, and the moves that its unknowns mean."""
        moves = list_free_directions(model, form, self.speed)
        fit = self.fit_moves(
            model, moves, starts, make_weak_prior(len(moves)), iterations=self.setting.iterations
        )
        return shift_coefficients(model, fit.x @ moves), fit, moves


def make_weak_prior(n: int) -> GaussianPrior:
    """Hardly any belief about ``n`` coefficients."""
    return GaussianPrior(
        np.zeros(n), np.full(n, STRUCTURE_SEARCH.coefficient_deviation), np.full(n, -np.inf), np.full(n, 1e-5)
    )


def list_uncertain_directions(
    curvature: Float64[np.ndarray, "n n"], moves: Float64[np.ndarray, "n K"], *, deviation: float
) -> Float64[np.ndarray, "n K"]:
    """Changes of all coefficients, one standard deviation each and the largest first, that a fit leaves open.

    ``curvature`` is of the data by the fit's unknowns, ``deviation`` what was believed of each of these.
    """
    scatter = np.linalg.inv(curvature + np.eye(len(moves)) / deviation**2)
    values, vectors = np.linalg.eigh(scatter)
    return (vectors * np.sqrt(np.maximum(values, 0.0))).T[::-1] @ moves


@dataclass(frozen=True)
class PredictedGain:
    """A larger form, how many numbers are free in it, and the misfit it would take away to first order."""

    gain: float
    form: ModelStructure
    n: int


def predict_gains(
    trial: IdentificationProblem,
    model: MechanicalModel,
    form: ModelStructure,
    larger: list[ModelStructure],
    fit: ShootingFit,
) -> list[PredictedGain]:
    """What each larger form promises, from one set of slopes for all."""
    union = ModelStructure(
        mass=max(f.mass for f in larger),
        damping=max(f.damping for f in larger),
        potential=max(f.potential for f in larger),
        input_map=max(f.input_map for f in larger),
        dry=True,
        drag=True,
    )
    roomy = pad_model(model, union)
    moves = list_free_directions(roomy, union, trial.speed)
    linear = trial.make_sensitivity(roomy, moves).derivatives(np.zeros(len(moves)), fit.starts, trial.data)
    curvature, gradient, *_ = eliminate_starts(*linear)
    out = []
    for candidate in larger:
        own = list_free_directions(pad_model(model, candidate), candidate, trial.speed)
        kept = np.flatnonzero(_within(roomy, own, moves, pad_model(model, candidate)))
        h = curvature[np.ix_(kept, kept)] + np.eye(len(kept)) / 9.0
        gain = float(gradient[kept] @ np.linalg.lstsq(h, gradient[kept], rcond=1e-12)[0])
        out.append(PredictedGain(gain, candidate, len(kept)))
    return out


def _within(roomy: MechanicalModel, own: np.ndarray, moves: np.ndarray, small: MechanicalModel) -> np.ndarray:
    """Which of ``moves`` of the roomy model change only what the small one has and its form frees."""
    touched = np.zeros(moves.shape[1], dtype=bool)
    at, at_small = 0, 0
    freed = (own != 0.0).any(axis=0)
    for name in COEFFICIENT_FIELDS:
        size, size_small = getattr(roomy, name).size, getattr(small, name).size
        touched[at : at + size_small] = freed[at_small : at_small + size_small]
        at, at_small = at + size, at_small + size_small
    return np.array([touched[row != 0.0].all() for row in moves])


def fit_first_model(
    trial: IdentificationProblem, basis: Basis, form: ModelStructure, width: np.ndarray
) -> MechanicalModel:
    """A model by the weak equations.

    Of many coordinates some swing so much faster than others that no one test function suits all, and weigh
    so little that a ridge would outweigh them: there the models by several of them compete.
    """
    record, rest = trial.dataset, np.median(trial.dataset.q, axis=0)

    def told(share: float, *ridges: float) -> list[MechanicalModel]:
        test_s = share * trial.setting.test_s
        samples = build_weak_form_samples(basis, record, trial.smooth, record.v, width_s=test_s, speed=width)
        rows, known, names = build_regressors(samples, form)
        return [build_model(samples, form, solve_ridge(rows, known, ridge), names, rest) for ridge in ridges]

    ridge = trial.setting.ridge
    if trial.dataset.d > MAX_FEW_COORDINATES:
        return min(
            (m for share in STRUCTURE_SEARCH.test_width_factors for m in told(share, ridge, 1e-3 * ridge)),
            key=trial.compute_misfit,
        )
    model, stiff = told(1.0, ridge, 0.1)
    return model if np.linalg.eigvalsh(model.mass[0]).min() >= 0.05 else stiff


def search_structure(
    trial: IdentificationProblem, basis: Basis, *, driven: bool, width: np.ndarray
) -> tuple[float, MechanicalModel, ModelStructure, ShootingFit, np.ndarray]:
    """From a linear system, by the form that promises most, as long as it keeps its promise.

    The cost is that of the Bayesian information criterion.
    """
    form = ModelStructure(1, 1, list_field_sizes(basis)[2], 1 if driven else 0)
    model, fit, moves = trial.refine(fit_first_model(trial, basis, form, width), form, trial.initial_states)

    def cost(fit: ShootingFit, n: int) -> float:
        return trial.n_data * np.log(max(fit.misfit / trial.n_data, 0.5)) + n * np.log(trial.n_data)

    best, refused = cost(fit, len(moves)), set[ModelStructure]()
    while True:
        larger = [f for f in list_larger_structures(form, basis, driven=driven) if f not in refused]
        if not larger or fit.misfit < 0.6 * trial.n_data:
            return best, model, form, fit, moves
        after = [
            (trial.n_data * np.log(max((fit.misfit - one.gain) / trial.n_data, 0.5))
             + one.n * np.log(trial.n_data), one.form.order, one)
            for one in predict_gains(trial, model, form, larger, fit)
        ]  # fmt: skip
        hoped, _, chosen = min(after, key=lambda row: row[:2])
        if hoped > best:
            return best, model, form, fit, moves
        candidate = chosen.form
        tried = trial.refine(pad_model(model, candidate), candidate, fit.starts)
        if cost(tried[1], len(tried[2])) < best:
            worth = tried[1].misfit < (1.0 - STRUCTURE_SEARCH.min_misfit_reduction) * fit.misfit
            (model, fit, moves), form = tried, candidate
            best = cost(fit, len(moves))
            if trial.dataset.d > MAX_FEW_COORDINATES and not worth:
                return best, model, form, fit, moves
            refused.clear()
        else:
            refused.add(candidate)


def add_unseen_terms(
    trial: IdentificationProblem, model: MechanicalModel, form: ModelStructure, fit: ShootingFit, basis: Basis
) -> tuple[MechanicalModel, np.ndarray, np.ndarray]:
    """The model with room for the next terms of its potential; the curvature and the moves with these.

    The recordings did not pay for them, and so say that they are small where they were, and nothing of what
    lies beyond: a motion that goes further must not find the law certain there.
    """
    ends = [end for end in list_field_sizes(basis) if end > form.potential][:2]
    wider = replace(form, potential=ends[-1]) if ends else form
    roomy = pad_model(model, wider)
    sizes = (len(roomy.mass), len(roomy.damping), len(roomy.potential), len(roomy.input_map))
    roomy = replace(roomy, basis=basis.first(max(sizes)))
    moves = list_free_directions(roomy, wider, trial.speed)
    linear = trial.make_sensitivity(roomy, moves).derivatives(np.zeros(len(moves)), fit.starts, trial.data)
    return roomy, eliminate_starts(*linear)[0], moves


def identify_model(
    record: Dataset,
    smooth: Float64[np.ndarray, "N d"],
    sigma: Float64[np.ndarray, " d"],
    period_s: float,
    setting: IdentificationSettings,
    windows: WindowSet,
    *,
    held: bool,
) -> IdentifiedModel:
    """The model of a sim from some ``windows`` of its recordings."""
    data = ShootingData(
        windows.take(record.q),
        windows.mask()[..., None] / sigma,
        1e-4 * np.concatenate([np.std(record.q, axis=0), np.std(record.v, axis=0)]),
    )
    steps = max(1, int(np.ceil(record.dt_s * setting.steps_per_period / period_s)))
    speed = np.std(record.v, axis=0)
    trial = IdentificationProblem(
        record, smooth, speed, windows, data, steps, held, replace(setting, test_s=0.5 * period_s)
    )
    driven = record.u.shape[1] > 0
    degree = {1: 7, 2: 5}.get(record.d, 3)
    options = []
    for basis in build_candidate_bases(record.q, degree=degree):
        options.append(search_structure(trial, basis, driven=driven, width=0.02 * speed))
        if options[-1][3].misfit < 1.1 * trial.n_data:
            break
    cost, model, form, fit, moves = min(options, key=lambda option: option[0])
    whole = model.basis
    model = replace(
        model,
        basis=model.basis.first(
            max(len(model.mass), len(model.damping), len(model.potential), len(model.input_map))
        ),
    )
    misfit = fit.misfit / max(trial.n_data - len(moves), 1.0)
    curvature = fit.curvature
    if record.d <= MAX_FEW_COORDINATES:
        model, curvature, moves = add_unseen_terms(trial, model, form, fit, whole)
    freedom = list_uncertain_directions(
        curvature / max(misfit, 1.0), moves, deviation=STRUCTURE_SEARCH.coefficient_deviation
    )
    apart, left = decouple_inertia(model, freedom)
    if apart is not model and trial.compute_misfit(apart) < STRUCTURE_SEARCH.equivalent_misfit_ratio * max(
        fit.misfit, trial.n_data
    ):
        model, freedom = apart, left
    return IdentifiedModel(model, form, misfit, freedom, fit, windows, cost)
