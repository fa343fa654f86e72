"""The estimation problem of all hypotheses: data, simulator, noise and priors; fits and their evidence.

One hypothesis is fitted by multiple shooting; its evidence is Laplace's approximation.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float64
from scipy.stats import chi2

from lagsplat.diagnose.core.config import IDENTIFICATION, PROBLEM, SELECTION, DiagnoseConfig
from lagsplat.diagnose.data_quality.discontinuities import find_repeated_samples
from lagsplat.diagnose.data_quality.natural_period import (
    estimate_natural_period_s,
    estimate_spectral_period_s,
)
from lagsplat.diagnose.effects.base import PlacedEffect
from lagsplat.diagnose.estimation import multiple_shooting as shooting
from lagsplat.diagnose.estimation.dataset import (
    Dataset,
    WindowSet,
    cut_windows,
    measure_window_noise,
    prepare_dataset,
)
from lagsplat.diagnose.estimation.nuisance import NuisanceParameters
from lagsplat.diagnose.estimation.rollout import RolloutModel
from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.io.trajectory.trajectory import Trajectory


@dataclass(frozen=True)
class EstimationProblem:
    """What a hypothesis is fitted to: a simulator beside the data, the windows, and the noise.

    ``sigma`` (d,) is the standard deviation of a sample; ``iterations`` and ``tolerance`` end a fit.
    """

    rollout_model: RolloutModel
    windows: WindowSet
    sigma: Float64[np.ndarray, " d"]
    iterations: int
    tolerance: float
    repeated_samples: Bool[np.ndarray, " N"]  # samples that repeat an earlier one; they are not fitted
    noise_inflation: float
    """Factor on the noise variance in fits: misfit on the sim's own recordings, and its correlation."""
    period_s: float  # longest natural period of the sim about its rest [s]
    own_error: Float64[np.ndarray, " d"] | float = 0.0
    """Mean square error of the sim's forecasts of its own recordings, beyond the noise [coordinate^2]."""
    excluded_windows: int = 0  # windows that are left out because the sim was never seen to move so

    @property
    def dataset(self) -> Dataset:
        """The recording."""
        return self.rollout_model.dataset

    @cached_property
    def repeats(self) -> Bool[np.ndarray, "W L"]:
        """Mask of the repeated samples in the windows."""
        return (self.windows.mask() > 0.0) & self.windows.take(self.repeated_samples)

    @cached_property
    def data(self) -> shooting.ShootingData:
        """The windows' samples, by their `deviation`; repeated ones do not count."""
        data = shooting.ShootingData.of(self.dataset, self.windows, self.deviation)
        return replace(data, weight=data.weight * ~self.repeats[..., None])

    @property
    def deviation(self) -> Float64[np.ndarray, " d"]:
        """Standard deviation of a sample from the forecast of a sim that lacks nothing."""
        return np.sqrt(self.sigma**2 + self.own_error)

    @property
    def degrees_of_freedom(self) -> float:
        """Number of samples less that of the initial states."""
        w, d = self.windows, self.dataset.d
        return float((w.length.sum() - self.repeats.sum()) * d - 2 * d * len(w.first))

    @property
    def motionless_misfit(self) -> float:
        """Mean square of the motion about its mean [noise variances]: the misfit of a sim at rest."""
        y, weight = self.data.y, self.data.weight
        middle = np.average(y, axis=(0, 1), weights=weight > 0.0)
        return float((((y - middle) * weight) ** 2).sum()) / self.degrees_of_freedom

    @cached_property
    def initial_states(self) -> np.ndarray:
        """Initial states of the windows from the smoothed data, (W, 2 d)."""
        return self.windows.initial_states(self.dataset)

    def shorten(self, longest_s: float) -> "EstimationProblem":
        """The same on evenly spaced windows that last at most about ``longest_s`` together."""
        return replace(self, windows=self.windows.subsample(longest_s / self.dataset.dt_s))

    def halve_windows(self) -> "EstimationProblem":
        """The same on windows half as long, none below `PROBLEM.min_window_frames` frames."""
        return replace(self, windows=self.windows.halve(PROBLEM.min_window_frames))

    def with_nuisance(self, nuisance: NuisanceParameters) -> "EstimationProblem":
        """The same with other uncertainties of the sim."""
        return replace(self, rollout_model=replace(self.rollout_model, nuisance=nuisance))

    def predict(self, effects: Sequence[PlacedEffect]) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
        """The rollout function of a set of effects, of parameters and initial states."""
        return lambda x, starts: self.rollout_model.roll_out(effects, x, starts, self.windows)[0]

    def prior(self, effects: Sequence[PlacedEffect]) -> shooting.GaussianPrior:
        """Prior of the parameters in a fit, narrowed by the noise inflation."""
        prior = make_joint_prior(effects, self.rollout_model)
        return replace(prior, deviation=prior.deviation / np.sqrt(self.noise_inflation))

    def fit(
        self,
        effects: Sequence[PlacedEffect],
        x: np.ndarray,
        starts: np.ndarray | None = None,
        known: tuple[np.ndarray, np.ndarray] | None = None,
        prior: shooting.GaussianPrior | None = None,
        *,
        brief: bool = False,
    ) -> shooting.ShootingFit:
        """Fit the parameters of ``effects`` and the nuisance parameters by multiple shooting.

        It begins with ``x``, the parameters in this order, and with ``starts`` (W, 2 d), by default
        `initial_states`. ``known`` are a nearby fit's derivatives by the nuisance parameters and the starts,
        ``brief`` is as in `fit_multiple_shooting`.
        """
        return shooting.fit_multiple_shooting(
            self.predict(effects),
            x,
            self.initial_states if starts is None else starts,
            self.data,
            prior or self.prior(effects),
            iterations=self.iterations,
            tolerance=self.tolerance,
            known=known,
            brief=brief,
        )


def limit_squared_deviation(n: int) -> float:
    """Squared distance of ``n`` parameters from their prior means that chance rarely exceeds [variances]."""
    return float(chi2.ppf(PROBLEM.plausible_quantile, max(n, 1)))


def compute_excess_penalty(fit: shooting.ShootingFit, noise_inflation: float) -> float:
    """Penalty of the parameters beyond what their prior allows, in the units of the misfit."""
    return max(fit.penalty - limit_squared_deviation(len(fit.x)) * noise_inflation, 0.0)


def make_joint_prior(effects: Sequence[PlacedEffect], rollout_model: RolloutModel) -> shooting.GaussianPrior:
    """Gaussian prior of the parameters of ``effects``, then of the nuisance parameters."""
    priors = [p.prior for e in effects for p in e.effect.parameters]
    nuisance = rollout_model.nuisance.deviation
    deviation = np.concatenate([[p.deviation for p in priors], nuisance])
    return shooting.GaussianPrior(
        np.concatenate([[p.mean for p in priors], np.zeros(len(nuisance))]),
        deviation,
        np.concatenate([[p.lowest for p in priors], np.full(len(nuisance), -np.inf)]),
        np.concatenate([1e-3 * np.minimum(deviation[: len(priors)], 1.0), 1e-2 * nuisance]),
    )


def estimate_natural_periods(model: MechanicalModel, motions: Sequence[Trajectory]) -> tuple[float, float]:
    """Longest and shortest natural period [s], from stiffness and inertia at rest.

    They are within a factor of 3 (shortest: 5) of the rms period of the motions, and equal to it where no
    mode is stable. A controller that chatters moves them far faster than they swing: where their natural
    period is nearer to the model's, it takes the place of the rms period.
    """
    moving_s = estimate_spectral_period_s(motions)
    values = np.linalg.eigvals(np.linalg.solve(model.inertia, model.stiffness)).real
    values = values[values > 0.0]
    if not len(values):
        return moving_s, moving_s
    longest, shortest = (float(2.0 * np.pi / np.sqrt(value)) for value in (values.min(), values.max()))

    def miss(period_s: float) -> float:
        return abs(float(np.log(longest / period_s)))

    if miss(moving_s) > np.log(3.0):
        moving_s = min(moving_s, estimate_natural_period_s(motions) or moving_s, key=miss)
    most = 3.0 * moving_s
    return min(max(longest, moving_s / 3.0), most), min(max(shortest, moving_s / 5.0), most)


def build_problem(
    sim: EstimatedSimulator, real: Sequence[Trajectory], config: DiagnoseConfig
) -> EstimationProblem:
    """The estimation problem of all hypotheses about ``real``.

    Windows are shortened where the sim, refitted, explains less than half of the motion: there a fit has
    little to follow. An upright arm, say, leaves its path within a fraction of its natural period.

    Raises:
        ValueError: the trajectories are too short for a single window.
    """
    scale = sim.window_scale
    problem = _build_problem(sim, real, config)
    while problem.windows.longest > PROBLEM.min_window_frames and not _follows_motion(problem):
        scale *= IDENTIFICATION.window_scales[0]
        shorter = _build_problem(replace(sim, window_scale=scale), real, config)
        if shorter.windows.longest >= problem.windows.longest:
            break
        problem = shorter
    return _measure_noise_of_residual(problem, real)


def _measure_noise_of_residual(problem: EstimationProblem, real: Sequence[Trajectory]) -> EstimationProblem:
    """The problem with the noise that the sim, refitted, leaves, where it is larger than that of the motion.

    Beside the motion itself, noise that lasts is hardly seen.
    """
    brief = replace(problem, iterations=min(SELECTION.trial_iterations, problem.iterations))
    residual = brief.fit((), np.zeros(problem.rollout_model.nuisance.size)).residual * problem.deviation
    _, shortest_s = estimate_natural_periods(problem.rollout_model.model, real)
    found = measure_window_noise(problem.dataset, problem.windows, residual, period_s=shortest_s)
    return replace(problem, sigma=np.maximum(problem.sigma, found))


def _follows_motion(problem: EstimationProblem) -> bool:
    """Whether the sim, refitted to evenly spaced windows, explains enough of the motion."""
    part = replace(problem, windows=problem.windows.choose_evenly(SELECTION.tested_windows))
    enough = (1.0 - PROBLEM.min_explained_share) * part.motionless_misfit * part.degrees_of_freedom
    fit = replace(part, iterations=min(SELECTION.trial_iterations, part.iterations)).fit(
        (), np.zeros(part.rollout_model.nuisance.size)
    )
    return fit.misfit <= enough or part.fit((), fit.x, fit.starts).misfit <= enough


def _build_problem(
    sim: EstimatedSimulator, real: Sequence[Trajectory], config: DiagnoseConfig
) -> EstimationProblem:
    model = sim.model
    longest_s, shortest_s = estimate_natural_periods(model, real)
    ready = prepare_dataset(real, period_s=shortest_s)
    record = ready.dataset
    omega = 2.0 * np.pi / longest_s
    force = np.var(record.v, axis=0) / np.maximum(np.std(record.smooth, axis=0), 1e-12)
    nuisance = NuisanceParameters(
        config.potential,
        config.damping * omega,
        config.inputs,
        config.inertia,
        config.offset * force,
        config.warp,
        record.u.shape[1],
        sim.uncertainty_directions,
    )
    steps = max(1, int(np.ceil(record.dt_s * config.steps_per_period / shortest_s)))
    reach_s = config.window_periods * sim.window_scale * longest_s
    windows = cut_windows(record, length_s=reach_s, min_frames=PROBLEM.min_window_frames)
    if len(windows.first) < 4:
        windows = cut_windows(record, length_s=min(reach_s, longest_s), min_frames=PROBLEM.min_window_frames)
    problem = EstimationProblem(
        RolloutModel(model, record, nuisance, steps, config.input_hold == "zoh"),
        windows=windows,
        sigma=ready.sigma,
        iterations=config.iterations,
        tolerance=config.tolerance,
        repeated_samples=find_repeated_samples(record.q, record.clips, ready.sigma),
        noise_inflation=max(sim.misfit, 1.0) * sim.correlation,
        period_s=longest_s,
        own_error=sim.own_error,
    )
    problem = _leave_out_unknown(problem, sim)
    kept = select_visible_directions(problem, sim.uncertainty_directions)
    return problem.with_nuisance(replace(nuisance, directions=kept))


def _leave_out_unknown(problem: EstimationProblem, sim: EstimatedSimulator) -> EstimationProblem:
    """The problem without the windows in which the sim was never seen, unless they are too many."""
    windows = problem.windows
    known = np.ones(len(windows.first), dtype=bool)
    if sim.novelty_detector is not None:
        known &= sim.novelty_detector.find_similar(windows, problem.dataset)
    if sim.known_region is not None:
        as_given = np.zeros((1, problem.rollout_model.nuisance.size))
        predicted = problem.predict(())(as_given, problem.initial_states[None])[0]
        known &= sim.known_region.find_inside(windows.take(problem.dataset.smooth), predicted)
    if not known.sum() > PROBLEM.min_known_share * len(known):
        return problem
    excluded = int(np.count_nonzero(~known))
    return replace(problem, windows=windows.select(known), excluded_windows=excluded)


def select_visible_directions(
    problem: EstimationProblem, freedom: Float64[np.ndarray, "R K"]
) -> Float64[np.ndarray, "r K"]:
    """The combinations of uncertain directions that the data can determine, the most visible first."""
    if not len(freedom):
        return freedom
    prior, n = make_joint_prior((), problem.rollout_model), problem.rollout_model.nuisance.size
    step = prior.step.copy()
    step[n - len(freedom) :] = 0.1
    linear = shooting.differentiate_predictions(
        problem.predict(()), np.zeros(n), problem.initial_states, problem.data, step
    )
    curvature = shooting.eliminate_starts(*linear).curvature
    values, vectors = np.linalg.eigh(curvature[n - len(freedom) :, n - len(freedom) :])
    chosen = np.argsort(values)[::-1][: PROBLEM.max_open_directions]
    return vectors[:, chosen[values[chosen] > PROBLEM.min_visibility]].T @ freedom


@dataclass(frozen=True)
class HypothesisFit:
    """A set of effects, fitted to the data. The sim alone (`none`) is the empty set."""

    effects: tuple[PlacedEffect, ...]
    fit: shooting.ShootingFit
    log_evidence: float = float("nan")  # log evidence over `none` [nat]
    noise: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    """Parameters of an effect on single samples: estimate and both ends of the 90 % interval."""

    @property
    def name(self) -> str:
        """Name of the effect that was added last."""
        return self.effects[-1].effect.name

    @property
    def moves_samples(self) -> bool:
        """Whether one of the effects moves single samples, which no fit shows."""
        return not all(placed.changes_motion for placed in self.effects)

    @property
    def fitted(self) -> tuple[PlacedEffect, ...]:
        """The effects whose parameters are fitted: all but those on single samples."""
        return tuple(placed for placed in self.effects if placed.changes_motion)

    @property
    def n_effect_parameters(self) -> int:
        """Number of fitted parameters that belong to the effects; nuisance parameters follow them."""
        return sum(placed.size for placed in self.fitted)

    def parameter_slice(self, placed: PlacedEffect) -> slice:
        """Where the parameters of one of the `fitted` effects are in ``fit.x``."""
        at = sum(other.size for other in self.fitted[: self.fitted.index(placed)])
        return slice(at, at + placed.size)

    def name_parameters(self, placed: PlacedEffect) -> dict[str, float]:
        """Fitted parameters of one of the effects by name, in the units of the recording."""
        return placed.name_parameters(self.fit.x[self.parameter_slice(placed)])

    @property
    def nearby_slopes(self) -> tuple[np.ndarray, np.ndarray]:
        """Derivatives by the nuisance parameters and by the starts, where a fit nearby may begin."""
        return self.fit.slopes[..., self.n_effect_parameters :], self.fit.start_slopes


def compute_precision(
    fit: shooting.ShootingFit, prior: shooting.GaussianPrior, noise_inflation: float
) -> Float64[np.ndarray, "k k"]:
    """Inverse covariance of all parameters by Laplace's approximation."""
    return fit.curvature / noise_inflation + np.diag(1.0 / prior.deviation**2)


def compute_log_evidence(
    hypothesis: HypothesisFit, rollout_model: RolloutModel, noise_inflation: float
) -> float:
    """Laplace's approximation of the log evidence [nat].

    Source: MacKay, "Information Theory, Inference, and Learning Algorithms", 2003, ch. 28.
    """
    prior, fit = make_joint_prior(hypothesis.effects, rollout_model), hypothesis.fit
    effect_priors = [p.prior for e in hypothesis.effects for p in e.effect.parameters]
    log_prior = sum(p.log_density(float(x)) for p, x in zip(effect_priors, fit.x, strict=False))
    deviation = prior.deviation[len(effect_priors) :]
    nuisance = fit.x[len(effect_priors) :] / deviation
    nuisance_log_prior = -0.5 * float(nuisance @ nuisance) - float(np.log(deviation).sum())
    nuisance_log_prior -= 0.5 * len(nuisance) * np.log(2.0 * np.pi)
    h = compute_precision(fit, prior, noise_inflation)
    sign, log_det = np.linalg.slogdet(h)
    if sign <= 0:
        log_det = float(np.log(np.maximum(np.linalg.eigvalsh(h), 1e-12)).sum())
    k = len(fit.x)
    log_joint = -0.5 * fit.misfit / noise_inflation + log_prior + nuisance_log_prior
    return log_joint + 0.5 * k * np.log(2.0 * np.pi) - 0.5 * log_det - 0.5 * fit.log_det_starts
