"""Evidence for effects in recordings that have none: what a sim's own errors pass for.

A sim that was fitted is wrong in its own way wherever it goes. What effects gain on a recording of the very
mechanism it was fitted to, they gain by these errors, and on another recording they must gain more.

A given sim, moved until it tells its own recordings: what its law lacks there is not an effect.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.core.config import RECALIBRATION, DiagnoseConfig
from lagsplat.diagnose.data_quality.natural_period import estimate_spectral_period_s
from lagsplat.diagnose.estimation.dataset import drop_overlapping_windows
from lagsplat.diagnose.estimation.multiple_shooting import GaussianPrior, ShootingFit, eliminate_starts
from lagsplat.diagnose.identification.estimated_simulator import (
    EstimatedSimulator,
    make_identification_settings,
)
from lagsplat.diagnose.identification.novelty import NoveltyDetector, window_features
from lagsplat.diagnose.identification.structure_search import IdentificationProblem, list_uncertain_directions
from lagsplat.diagnose.inference.model_selection import SearchBudget, rank_hypotheses
from lagsplat.diagnose.inference.placement import find_hints, place_effects
from lagsplat.diagnose.inference.problem import (
    EstimationProblem,
    autocorrelation_time,
    build_problem,
    natural_periods,
)
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.mechanics.structure import (
    COEFFICIENT_FIELDS,
    MAX_FEW_COORDINATES,
    ModelStructure,
    list_field_sizes,
    list_free_directions,
    shift_coefficients,
)
from lagsplat.diagnose.simulators.projection import find_rest
from lagsplat.io.trajectory.trajectory import Trajectory, leading_samples


def calibrate_null_evidence(
    sim: EstimatedSimulator,
    own: Trajectory,
    real: Sequence[Trajectory],
    config: DiagnoseConfig,
    *,
    report_progress: Callable[[str], None] = lambda name: None,
) -> float:
    """Nats that an effect must gain beyond: `RECALIBRATION.null_evidence_factor` times what the best gains
    where there is none.

    That is on ``own``, taken as long as ``real`` is. Evidence grows with the time recorded, so that a shorter
    one is scaled up. Where the sim knows how it was seen to move, those stretches of ``own`` are taken that
    are most like those of ``real``, each as often as it is called for. Zero where nothing gains.

    Raises:
        ValueError: ``own`` is too short for a single window.
    """
    wanted_s = sum(motion.duration_s for motion in real)
    part = leading_samples(own, wanted_s)
    if sim.novelty_detector is None:
        problem, more = build_problem(sim, [part], config)[0], max(1.0, wanted_s / part.duration_s)
        quiet = drop_overlapping_windows(problem.windows, problem.rollout_model.dataset, sim.outlier_spans)
        problem = replace(problem, windows=quiet)
    else:
        problem, more = match_windows(sim, own, real, config), 1.0
    natural = natural_periods(sim.model, estimate_spectral_period_s([part]))
    candidates = place_effects(
        problem.rollout_model,
        find_hints(sim.model, [part], period_s=natural.longest_s, hold=config.input_hold),
        q_names=own.q_names,
        u_names=own.u_names,
        without=config.without,
    )
    budget = SearchBudget.of(config, nominal=max(1.0, sim.misfit))
    found = rank_hypotheses(problem, candidates, budget, report_progress=report_progress).found
    gained = max((one.log_evidence for one in found), default=0.0)
    return RECALIBRATION.null_evidence_factor * max(gained, 0.0) * more


def match_windows(
    sim: EstimatedSimulator, own: Trajectory, real: Sequence[Trajectory], config: DiagnoseConfig
) -> EstimationProblem:
    """The contest on stretches of the sim's ``own`` motion, one for each of ``real`` and most like it.

    A law has its errors where it has them: a recording that mostly swings freely meets other ones than the
    sim's own, which hardly does.
    """
    assert sim.novelty_detector is not None
    there, ready, _ = build_problem(sim, real, config)
    here, own_ready, _ = build_problem(sim, [own], config)
    chosen = sim.novelty_detector.find_nearest(
        window_features(there.windows, ready.smooth, ready.dataset),
        window_features(here.windows, own_ready.smooth, own_ready.dataset),
    )
    return replace(here, windows=here.windows.select(chosen))


@dataclass(frozen=True)
class CoefficientFit:
    """A model, the fit that moved it, and the moves (n, K) that the fit's unknowns mean."""

    model: MechanicalModel
    fit: ShootingFit
    moves: Float64[np.ndarray, "n K"]


def recalibrate_simulator(
    sim: EstimatedSimulator, motions: Sequence[Trajectory], config: DiagnoseConfig
) -> EstimatedSimulator:
    """``sim`` with its lower coefficients moved as ``motions``, which it is true to, ask for.

    Every other window is fitted, the others judge; a sim that does not tell these better comes back as it is.

    Raises:
        ValueError: the motions are too short for a single window.
    """
    problem, ready, _ = build_problem(sim, motions, config)
    rollout_model = problem.rollout_model
    windows = problem.windows.subsample(2.0 * config.reference_longest_s / rollout_model.dataset.dt_s)
    setting = make_identification_settings(config)

    def trial(first: int) -> IdentificationProblem:
        chosen = windows.select(np.arange(len(windows.first)) % 2 == first)
        data = replace(problem, windows=chosen).data
        speed = np.std(rollout_model.dataset.v, axis=0)
        return IdentificationProblem(
            rollout_model.dataset,
            ready.smooth,
            speed,
            chosen,
            data,
            rollout_model.steps,
            rollout_model.held,
            setting,
        )

    fitted, judging = trial(0), trial(1)
    missed, found = judging.compute_misfit(sim.model), None
    for step in (
        RECALIBRATION.degree_steps if sim.model.d <= MAX_FEW_COORDINATES else RECALIBRATION.degree_steps_many
    ):
        model = found.model if found else sim.model
        # by the half that is missed less: a law may run off in a single window of the other
        half = min(missed / judging.n_data, fitted.compute_misfit(model) / fitted.n_data)
        tried = fit_coefficients(fitted, model, step, excess=max(half, 1.0))
        left = judging.compute_misfit(tried.model)
        if not left < RECALIBRATION.max_remaining_misfit * missed:
            break
        missed, found = left, tried
    if found is None:
        return sim
    rested = replace(found.model, rest=find_rest(found.model))
    known = NoveltyDetector.from_recordings(problem.windows, ready.smooth, rollout_model.dataset)
    return replace(
        sim,
        model=rested,
        original=sim,
        uncertainty_directions=_unidentified_directions(found, fitted),
        novelty_detector=known,
    )


def movable_structure(model: MechanicalModel, step: tuple[int, int, int, int]) -> ModelStructure:
    """What may move in a step, within what the model has room for.

    The mass does so only as a whole: a fitted one may be all but singular, and soon is not positive.
    """
    ends = list_field_sizes(model.basis)
    mass, damping, potential, inputs = (ends[min(k, len(ends) - 1)] for k in step)
    return ModelStructure(
        min(mass, len(model.mass)),
        min(damping, len(model.damping)),
        min(potential, len(model.potential)),
        min(inputs, len(model.input_map)),
    )


def fit_coefficients(
    trial: IdentificationProblem, model: MechanicalModel, step: tuple[int, int, int, int], *, excess: float
) -> CoefficientFit:
    """The model moved; a misfit that is ``excess`` times the noise's is believed the less."""
    moves = independent_directions(trial, model, movable_structure(model, step))
    n = len(moves)
    belief = GaussianPrior(
        np.zeros(n),
        np.full(n, RECALIBRATION.move_deviation / np.sqrt(excess)),
        np.full(n, -np.inf),
        np.full(n, 1e-4),
    )
    iterations = RECALIBRATION.iterations_factor * trial.setting.iterations
    fit = trial.fit_moves(model, moves, trial.initial_states, belief, iterations=iterations)
    return CoefficientFit(shift_coefficients(model, fit.x @ moves), fit, moves)


def independent_directions(
    trial: IdentificationProblem, model: MechanicalModel, form: ModelStructure
) -> Float64[np.ndarray, "n K"]:
    """Moves within a form that change the acceleration by its own size each, and independently of each other.

    A coordinate that is light, or hardly moves, is then moved no further than another one.
    """
    record = trial.dataset
    at = np.unique(np.linspace(0, len(record.q) - 1, RECALIBRATION.direction_samples).astype(int))
    q, v, u = trial.smooth[at], record.v[at], record.u[at]
    base = model.acceleration(q, v, u)
    size = np.linalg.cholesky(np.linalg.pinv(base.T @ base / len(at)) + 1e-12 * np.eye(model.d))
    plain = list_free_directions(model, form, trial.speed)
    change = np.stack(
        [
            (shift_coefficients(model, RECALIBRATION.direction_step * one).acceleration(q, v, u) - base)
            / RECALIBRATION.direction_step
            for one in plain
        ]
    )
    rows = (change @ size).reshape(len(plain), -1) / np.sqrt(len(at))
    values, vectors = np.linalg.eigh(rows @ rows.T)
    kept = values > RECALIBRATION.direction_cutoff * values.max()
    return (vectors[:, kept] / np.sqrt(values[kept])).T @ plain


def inertia_direction(model: MechanicalModel) -> Float64[np.ndarray, " K"]:
    """The change of all coefficients that doubles the inertia, and nothing else."""
    return np.concatenate([(name == "mass") * getattr(model, name).ravel() for name in COEFFICIENT_FIELDS])


def _unidentified_directions(one: CoefficientFit, trial: IdentificationProblem) -> Float64[np.ndarray, "n K"]:
    """What the fit leaves open, its correlated residual counted as fewer samples.

    So is how heavy the mechanism is as a whole, which no move changes: without it a wrong inertia of the law
    would be a change of mass in whatever it is held against.
    """
    moves = np.concatenate([one.moves, inertia_direction(one.model)[None]])
    linear = trial.make_sensitivity(one.model, moves).derivatives(
        np.zeros(len(moves)), one.fit.starts, trial.data
    )
    curvature, *_ = eliminate_starts(*linear)
    misfit = max(one.fit.misfit / max(trial.n_data - len(one.moves), 1.0), 1.0)
    alike = autocorrelation_time(one.fit.residual, trial.windows.length)
    return list_uncertain_directions(
        curvature / (misfit * alike), moves, deviation=RECALIBRATION.move_deviation
    )
