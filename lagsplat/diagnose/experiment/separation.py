"""By how much an experiment is expected to separate two hypotheses, if the wrong one may refit itself.

The expected log Bayes factor of the true hypothesis is half of what the other one leaves of the motion at the
measured noise, after it moved its parameters as far as the recordings so far allow (T-optimality).

Sources: Atkinson & Fedorov 1975, doi:10.1093/biomet/62.1.57; with the covariance of earlier data, Box & Hill
1967, doi:10.1080/00401706.1967.10490441.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.core.config import EXPERIMENT, PROBLEM
from lagsplat.diagnose.effects.base import PlacedEffect, drop_recorded_beginnings
from lagsplat.diagnose.estimation import multiple_shooting as shooting
from lagsplat.diagnose.estimation.dataset import FILE_BREAK_S, Dataset, cut_windows
from lagsplat.diagnose.estimation.rollout import RolloutModel
from lagsplat.diagnose.experiment.candidates import Experiment, RecordedRange
from lagsplat.diagnose.inference.problem import (
    EstimationProblem,
    HypothesisFit,
    compute_precision,
    make_joint_prior,
)


@dataclass(frozen=True)
class FittedHypothesis:
    """A hypothesis after the recordings so far: its parameters are normal about ``x`` (k,)."""

    names: tuple[str, ...]  # its effects; empty for the sim alone
    effects: tuple[PlacedEffect, ...]
    x: Float64[np.ndarray, " k"]
    covariance: Float64[np.ndarray, "k k"]

    @classmethod
    def of(
        cls, problem: EstimationProblem, hypothesis: HypothesisFit, *, noise_inflation: float
    ) -> "FittedHypothesis":
        """The hypothesis by Laplace's approximation, without parameters of the old recording alone.

        These say where a memory began in it.
        """
        prior, fit = make_joint_prior(hypothesis.fitted, problem.rollout_model), hypothesis.fit
        precision = compute_precision(fit, prior, noise_inflation)
        effects, kept = drop_recorded_beginnings(hypothesis.fitted, fit.x)
        names = tuple(placed.effect.name for placed in hypothesis.effects)
        return cls(names, effects, fit.x[kept], np.linalg.pinv(precision)[np.ix_(kept, kept)])

    @property
    def precision(self) -> Float64[np.ndarray, "k k"]:
        """Inverse of the covariance, by way of the correlations: deviations differ by powers of ten."""
        deviation = np.sqrt(np.maximum(np.diag(self.covariance), np.finfo(float).tiny))
        scale = np.outer(deviation, deviation)
        return np.linalg.pinv(self.covariance / scale, hermitian=True) / scale

    def draw(self, rng: np.random.Generator, lowest: np.ndarray) -> "FittedHypothesis":
        """The same with parameters drawn from their distribution, at least ``lowest`` (k,)."""
        x = rng.multivariate_normal(self.x, self.covariance, method="eigh")
        return replace(self, x=np.maximum(x, lowest))


@dataclass(frozen=True)
class Separation:
    """The expected log Bayes factor of one hypothesis over another [nat], and where it comes from."""

    nats: float
    coordinate: int  # where the two differ most after the refit, as a multiple of the noise
    time_s: float
    expected: tuple[float, float]  # that coordinate then: by the true one, and by the other after its refit


def simulate_experiment(
    problem: EstimationProblem, hypothesis: FittedHypothesis, experiment: Experiment
) -> tuple[RolloutModel, np.ndarray]:
    """What a hypothesis predicts: rollouts about the predicted motion, and its states (N, 2 d).

    The clock goes on after the recording, so that what happened at an instant of it does not come again.
    """
    old, d, n = problem.rollout_model, len(experiment.start), len(experiment.time_s)
    still = np.repeat(experiment.start[None], n, axis=0)
    time = experiment.time_s + old.dataset.time[-1] + FILE_BREAK_S
    record = Dataset.single_clip(time, still, np.zeros((n, d)), experiment.u)
    model = replace(old, dataset=record, payload=experiment.payload)
    whole = cut_windows(record, length_s=np.inf, min_frames=2)
    start = np.concatenate([experiment.start, np.zeros(d)])[None, None]
    y, v = (each[0, 0] for each in model.roll_out(hypothesis.effects, hypothesis.x[None], start, whole))
    return replace(model, dataset=replace(record, q=y, v=v, smooth=y)), np.concatenate([y, v], axis=1)


def compute_separation(
    problem: EstimationProblem,
    truth: FittedHypothesis,
    rival: FittedHypothesis,
    experiment: Experiment,
    *,
    noise_inflation: float,
    window_s: float,
    refit_steps: int = EXPERIMENT.refit_steps,
) -> Separation:
    """The expected log Bayes factor of ``truth`` over ``rival`` by an experiment.

    The rival fits its parameters, near those of the recordings so far, and the states where windows begin,
    by ``refit_steps`` Gauss-Newton steps. Windows last about ``window_s``. It is zero where the motion
    leaves the visited range or diverges: parameters drawn at random may be unstable.
    """
    model, states = simulate_experiment(problem, truth, experiment)
    if not RecordedRange.of(problem.dataset).holds(states[:, : problem.dataset.d]):
        return Separation(0.0, 0, 0.0, (np.nan, np.nan))
    record, prior = model.dataset, make_joint_prior(rival.effects, model)
    windows = cut_windows(record, length_s=window_s, min_frames=PROBLEM.min_window_frames)
    data = shooting.ShootingData.of(record, windows, problem.sigma)

    def predict(x: np.ndarray, starts: np.ndarray) -> np.ndarray:
        return model.roll_out(rival.effects, x, starts, windows)[0]

    precision = rival.precision
    x, starts, best = rival.x, states[windows.first], None
    for _ in range(refit_steps):
        linear = shooting.differentiate_predictions(predict, x, starts, data, prior.step)
        if not all(np.isfinite(part).all() for part in linear):
            break
        moved = x - rival.x
        cost = 0.5 * float(np.sum(linear[0] ** 2)) / noise_inflation + 0.5 * float(moved @ precision @ moved)
        try:
            left = shooting.eliminate_starts(*linear)
        except np.linalg.LinAlgError:  # a rollout that no longer depends on where it starts
            break
        right = left.right / noise_inflation - precision @ moved
        move = np.linalg.lstsq(left.curvature / noise_inflation + precision, right, rcond=1e-13)[0]
        start_moves = left.follow(move)
        change = linear[1] @ move + np.einsum("wms,ws->wm", linear[2], start_moves)
        rest = linear[0] - change.reshape(linear[0].shape)
        after = moved + move
        least = 0.5 * float(np.sum(rest**2)) / noise_inflation + 0.5 * float(after @ precision @ after)
        if best is None or cost < best[0]:
            best = cost, max(min(least, cost), 0.0), rest
        x, starts = np.maximum(x + move, prior.lowest), starts + start_moves
    if best is None:
        return Separation(0.0, 0, 0.0, (np.nan, np.nan))
    _, nats, rest = best
    window, frame, coordinate = np.unravel_index(int(np.argmax(np.abs(rest))), rest.shape)
    own = float(data.y[window, frame, coordinate])
    other = own - float(rest[window, frame, coordinate] * problem.sigma[coordinate])
    time_s = float(experiment.time_s[windows.first[window] + frame])
    return Separation(nats, int(coordinate), time_s, (own, other))
