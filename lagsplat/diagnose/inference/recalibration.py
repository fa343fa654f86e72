"""Calibration of a sim on recordings without any effect: of its coefficients, and of the evidence it gives.

A fitted sim has errors of its own. On a recording of the very mechanism it was fitted to, effects gain
evidence by these errors alone; on another recording they must gain more. A given sim is recalibrated on its
own recordings before anything is compared, so that what its law lacks there does not count as an effect.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.core.config import RECALIBRATION, SELECTION, DiagnoseConfig
from lagsplat.diagnose.estimation.dataset import drop_overlapping_windows
from lagsplat.diagnose.estimation.multiple_shooting import (
    GaussianPrior,
    ShootingFit,
    compute_autocorrelation_time,
)
from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator
from lagsplat.diagnose.identification.novelty import NoveltyDetector, window_features
from lagsplat.diagnose.identification.structure_search import IdentificationProblem, list_uncertain_directions
from lagsplat.diagnose.inference.holdout import measure_own_error
from lagsplat.diagnose.inference.model_selection import SearchBudget, rank_hypotheses
from lagsplat.diagnose.inference.placement import find_hints, place_effects
from lagsplat.diagnose.inference.problem import (
    EstimationProblem,
    HypothesisFit,
    build_problem,
    compute_excess_penalty,
    estimate_natural_periods,
)
from lagsplat.diagnose.mechanics import structure
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.simulators.projection import find_rest
from lagsplat.io.trajectory.trajectory import Trajectory, leading_samples


def calibrate_misfit(
    sim: EstimatedSimulator, motions: Sequence[Trajectory], config: DiagnoseConfig
) -> EstimatedSimulator:
    """Measure a given sim's misfit, and its correlation, on recordings of the very mechanism it models.

    An error of a sim lasts for a part of a period, so many samples count as one. Of long recordings windows
    that last ``config.reference_longest_s`` together are used, evenly spread.
    """
    return measure_misfit(sim, build_problem(sim, motions, config).shorten(config.reference_longest_s))


def measure_misfit(sim: EstimatedSimulator, problem: EstimationProblem) -> EstimatedSimulator:
    """Set the sim's misfit, and its correlation, to what it leaves of a problem without any effect."""
    still, length = np.zeros(problem.rollout_model.nuisance.size), problem.windows.length
    fit = problem.fit((), still)
    # the second fit knows the correlation: a long error then costs less to leave than to follow
    correlation = compute_autocorrelation_time(fit.residual, length)
    noise_inflation = max(fit.misfit / problem.degrees_of_freedom, 1.0) * correlation
    fit = replace(problem, noise_inflation=noise_inflation).fit((), still)
    left = (fit.misfit + compute_excess_penalty(fit, noise_inflation)) / problem.degrees_of_freedom
    return replace(sim, misfit=left, correlation=compute_autocorrelation_time(fit.residual, length))


def separate_own_error(sim: EstimatedSimulator, problem: EstimationProblem) -> EstimatedSimulator:
    """Set the error of the sim's forecasts, coordinate by coordinate, where there is no effect.

    Its misfit then counts that error as noise: a learned law errs far more in one coordinate than in another,
    which a single factor on the noise of all would hide.
    """
    none = HypothesisFit((), problem.fit((), np.zeros(problem.rollout_model.nuisance.size)))
    own_error = measure_own_error(problem, none)
    return measure_misfit(replace(sim, own_error=own_error), replace(problem, own_error=own_error))


def calibrate_null_evidence(
    sim: EstimatedSimulator,
    reference: Trajectory,
    real: Sequence[Trajectory],
    config: DiagnoseConfig,
    *,
    report_progress: Callable[[str], None] = lambda name: None,
) -> float:
    """Log evidence [nat] that the best effect gains where there is none, times
    `RECALIBRATION.null_evidence_factor`; 0 where no effect gains.

    Evidence grows with duration, so a reference that is shorter than the real trajectories counts more in
    proportion. Where the sim has a novelty detector, the windows of the reference that are most similar to
    the real ones are used, each as often as it is the nearest.

    Raises:
        ValueError: ``reference`` is too short for a single window.
    """
    wanted_s = sum(motion.duration_s for motion in real)
    part = leading_samples(reference, wanted_s)
    if sim.novelty_detector is None:
        problem, duration_ratio = build_problem(sim, [part], config), max(1.0, wanted_s / part.duration_s)
        quiet = drop_overlapping_windows(problem.windows, problem.dataset, sim.outlier_spans)
        problem = replace(problem, windows=quiet)
    else:
        problem, duration_ratio = choose_null_windows(sim, reference, real, config), 1.0
    period_s, _ = estimate_natural_periods(sim.model, [part])
    hints = find_hints(sim.model, [part], period_s=period_s, hold=config.input_hold)
    q_names, u_names = reference.q_names, reference.u_names
    candidates = place_effects(
        problem.rollout_model,
        hints,
        q_names=q_names,
        u_names=u_names,
        without=config.without,
        targets=config.targets,
        computed=reference.computed,
    )
    # only the best counts, and so small an effect gains what its score test says
    budget = SearchBudget(config, max(1.0, sim.misfit))
    narrow = budget.narrow(continued=SELECTION.refined_fits, refined=SELECTION.refined_fits)
    found = rank_hypotheses(problem, candidates, narrow, report_progress=report_progress).found
    gained = max((fit.log_evidence for fit in found), default=0.0)
    return RECALIBRATION.null_evidence_factor * max(gained, 0.0) * duration_ratio


def choose_null_windows(
    sim: EstimatedSimulator, reference: Trajectory, real: Sequence[Trajectory], config: DiagnoseConfig
) -> EstimationProblem:
    """The estimation problem on windows of the reference that last as long as ``config.reference_longest_s``.

    Where the sim has a novelty detector they are, for each real window, the most similar one: the errors of a
    law depend on the state, so the reference must visit the states of the real trajectories.
    """
    own = build_problem(sim, [reference], config)
    if sim.novelty_detector is None:
        return own.shorten(config.reference_longest_s)
    other = build_problem(sim, real, config)
    own_features, features = (window_features(each.windows, each.dataset) for each in (own, other))
    chosen = sim.novelty_detector.find_nearest(features, own_features)
    return replace(own, windows=own.windows.select(chosen))


@dataclass(frozen=True)
class CoefficientFit:
    """A recalibrated model and its fit."""

    model: MechanicalModel
    fit: ShootingFit
    moves: Float64[np.ndarray, "n K"]  # changes of all coefficients by one unit of each fitted parameter


def recalibrate_simulator(
    sim: EstimatedSimulator, motions: Sequence[Trajectory], config: DiagnoseConfig
) -> EstimatedSimulator:
    """Fit a sim's coefficients of low degree to recordings of the very mechanism it models.

    Every other window is fitted, and the others validate: a step that does not improve them is undone. The
    sim itself is returned where no step does.

    Raises:
        ValueError: the motions are too short for a single window.
    """
    problem = build_problem(sim, motions, config)
    windows = problem.shorten(2.0 * config.reference_longest_s).windows

    def take_half(first: int) -> IdentificationProblem:
        chosen = windows.select(np.arange(len(windows.first)) % 2 == first)
        data = replace(problem, windows=chosen).data
        return IdentificationProblem(problem.dataset, chosen, data, problem.rollout_model.steps, config)

    training, validation = take_half(0), take_half(1)
    misfit, best = validation.compute_misfit(sim.model), None
    few = sim.model.d <= structure.MAX_FEW_COORDINATES
    for step in RECALIBRATION.degree_steps if few else RECALIBRATION.degree_steps_many:
        model = best.model if best else sim.model
        # the half with the smaller misfit counts: a law may diverge in a single window of the other
        half = min(misfit / validation.n_data, training.compute_misfit(model) / training.n_data)
        tried = fit_coefficients(training, model, step, excess=max(half, 1.0))
        left = validation.compute_misfit(tried.model)
        if not left < RECALIBRATION.max_remaining_misfit * misfit:
            break
        misfit, best = left, tried
    if best is None:
        return sim
    return replace(
        sim,
        model=replace(best.model, rest=find_rest(best.model)),
        original=sim,
        uncertainty_directions=_unidentified_directions(best, training),
        novelty_detector=NoveltyDetector.from_recordings(problem.windows, problem.dataset),
    )


def choose_structure(model: MechanicalModel, step: tuple[int, int, int, int]) -> structure.ModelStructure:
    """The coefficients that may change in a step, as far as the model has them.

    The mass changes only as a whole: a fitted one may be nearly singular and soon be no longer positive.
    """
    ends = structure.list_field_sizes(model.basis)
    fields = (model.mass, model.damping, model.potential, model.input_map)
    mass, damping, potential, inputs = (
        min(ends[min(k, len(ends) - 1)], len(field)) for k, field in zip(step, fields, strict=True)
    )
    return structure.ModelStructure(mass, damping, potential, inputs)


def fit_coefficients(
    trial: IdentificationProblem, model: MechanicalModel, step: tuple[int, int, int, int], *, excess: float
) -> CoefficientFit:
    """Fit the coefficients of one step; the larger the misfit before, the narrower the prior.

    ``step`` are the highest degrees of mass, damping, potential and input map that change, ``excess`` is the
    mean square residual before the step [noise variances].
    """
    moves = find_independent_directions(trial, model, choose_structure(model, step))
    deviation = RECALIBRATION.move_deviation / np.sqrt(excess)
    prior = GaussianPrior(*(np.full(len(moves), value) for value in (0.0, deviation, -np.inf, 1e-4)))
    iterations = RECALIBRATION.iterations_factor * trial.config.identify_iterations
    fit = trial.fit_moves(model, moves, trial.initial_states, prior, iterations=iterations)
    return CoefficientFit(structure.shift_coefficients(model, fit.x @ moves), fit, moves)


def find_independent_directions(
    trial: IdentificationProblem, model: MechanicalModel, form: structure.ModelStructure
) -> Float64[np.ndarray, "n K"]:
    """Independent coefficient changes, each of which changes the acceleration by its own rms.

    Scaled so, a coordinate that is light, or hardly moves, changes no more than another one.
    """
    record = trial.dataset
    at = np.unique(np.linspace(0, len(record.q) - 1, RECALIBRATION.direction_samples).astype(int))
    q, v, u = record.smooth[at], record.v[at], record.u[at]
    base = model.acceleration(q, v, u)
    size = np.linalg.cholesky(np.linalg.pinv(base.T @ base / len(at)) + 1e-12 * np.eye(model.d))
    plain, step = structure.list_free_directions(model, form, trial.speed), RECALIBRATION.direction_step
    moved = (structure.shift_coefficients(model, step * move).acceleration(q, v, u) for move in plain)
    change = np.stack([(acceleration - base) / step for acceleration in moved])
    rows = (change @ size).reshape(len(plain), -1) / np.sqrt(len(at))
    values, vectors = np.linalg.eigh(rows @ rows.T)
    kept = values > RECALIBRATION.direction_cutoff * values.max()
    return (vectors[:, kept] / np.sqrt(values[kept])).T @ plain


def _unidentified_directions(fit: CoefficientFit, trial: IdentificationProblem) -> Float64[np.ndarray, "n K"]:
    """Directions of one posterior standard deviation each; a correlated residual counts as fewer samples.

    The scale of the inertia is added, which no step changes: otherwise a wrong inertia of the law would
    appear as a change of mass in every diagnosis.
    """
    inertia = [(name == "mass") * getattr(fit.model, name).ravel() for name in structure.COEFFICIENT_FIELDS]
    moves = np.concatenate([fit.moves, np.concatenate(inertia)[None]])
    curvature, _ = trial.linearise(fit.model, moves, fit.fit.starts)
    misfit = max(fit.fit.misfit / max(trial.n_data - len(fit.moves), 1.0), 1.0)
    per_sample = misfit * compute_autocorrelation_time(fit.fit.residual, trial.windows.length)
    return list_uncertain_directions(curvature / per_sample, moves, deviation=RECALIBRATION.move_deviation)
