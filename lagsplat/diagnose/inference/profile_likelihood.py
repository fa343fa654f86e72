"""Fitted parameters with units, intervals and profile likelihoods, and which effects could be separated."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.core.config import PROFILES, VERDICT
from lagsplat.diagnose.core.result import Parameter
from lagsplat.diagnose.effects.base import PlacedEffect, SampleEffect
from lagsplat.diagnose.effects.parameters import UNITS
from lagsplat.diagnose.estimation import multiple_shooting as shooting
from lagsplat.diagnose.estimation.dataset import Dataset
from lagsplat.diagnose.inference.problem import (
    EstimationProblem,
    HypothesisFit,
    compute_precision,
    make_joint_prior,
)


def compute_posterior_deviations(
    fit: shooting.ShootingFit, prior: shooting.GaussianPrior, noise_inflation: float
) -> Float64[np.ndarray, " k"]:
    """Standard deviations of all parameters by Laplace's approximation."""
    covariance = np.linalg.pinv(compute_precision(fit, prior, noise_inflation))
    return np.sqrt(np.maximum(np.diag(covariance), 0.0))


def estimate_refit(
    problem: EstimationProblem,
    none: HypothesisFit,
    noise_inflation: float,
    names: tuple[Sequence[str], Sequence[str]],
) -> list[dict[str, Any]]:
    """How a refit without effects moves the sim's own numbers, each with its 90 % interval and unit.

    ``names`` are those of the coordinates and of the inputs.
    """
    q_names, u_names = names
    prior, model = make_joint_prior((), problem.rollout_model), problem.rollout_model.nuisance
    spread = VERDICT.interval_z * compute_posterior_deviations(none.fit, prior, noise_inflation)
    moves = [
        ("stiffness and weight", "relative change"),
        ("damping rate", "1/s"),
        *((f"gain of {name}", "relative change") for name in u_names),
        *((f"inertia along {name}", "relative change") for name in q_names if len(q_names) > 1),
        *((f"acceleration along {name}", "per s^2") for name in q_names),
    ]
    numbers = zip(moves, none.fit.x, spread, model.deviation, strict=False)
    return [
        {"name": name, "value": x, "low": x - half, "high": x + half, "tolerance": tolerance, "unit": unit}
        for (name, unit), x, half, tolerance in numbers
    ]


def estimate_parameters(
    problem: EstimationProblem, hypothesis: HypothesisFit, placed: PlacedEffect, noise_inflation: float
) -> dict[str, Parameter]:
    """The parameters of one effect of a hypothesis in physical units, with 90 % intervals.

    Their keys are those of ``diagnosis.json``.
    """
    out = {}
    if isinstance(placed.effect, SampleEffect):
        kinds = {p.name: p.kind for p in placed.effect.parameters}
        for name, row in hypothesis.noise.items():
            sized = [value * placed.scales.of(kinds[name]) for value in row]
            out[name] = Parameter(sized[0], sized[1], sized[2], UNITS[kinds[name]])
        return out
    prior = make_joint_prior(hypothesis.fitted, problem.rollout_model)
    cut, record = hypothesis.parameter_slice(placed), problem.dataset
    deviation = compute_posterior_deviations(hypothesis.fit, prior, noise_inflation)[cut]
    reach = VERDICT.interval_z * (VERDICT.deviation_factor * deviation + VERDICT.deviation_floor)
    best = hypothesis.fit.x[cut]
    low, high = np.maximum(best - reach, prior.lowest[cut]), best + reach
    published = list_published_parameters(placed, best, record)
    moved = []  # with one parameter after another at either end of its interval
    for i, ends in enumerate(zip(low, high, strict=True)):
        for end in ends:
            x = best.copy()
            x[i] = end
            moved.append(list_published_parameters(placed, x, record))
    for key, value in published.items():
        others = [other.get(key, value) for other in moved]
        alike = [other for other in others if np.shape(other) == np.shape(value)]
        first, second = _combine_intervals(value, alike)
        out[key] = Parameter(value, first, second, format_parameter_unit(placed, key))
    return out


def _combine_intervals(value: Any, others: Sequence[Any]) -> tuple[Any, Any]:
    """Both ends of the interval of a number, or of each of several, from its changes by each parameter."""
    change = np.array([np.subtract(other, value) for other in others]).reshape(-1, *np.shape(value))
    low = np.subtract(value, np.sqrt(np.sum(np.minimum(change, 0.0) ** 2, axis=0)))
    high = np.add(value, np.sqrt(np.sum(np.maximum(change, 0.0) ** 2, axis=0)))
    return low.tolist(), high.tolist()


def format_parameter_unit(placed: PlacedEffect, key: str) -> str:
    """Unit of a published parameter, the first one's where the key has none of its own."""
    effect = placed.effect
    if key == "files":
        return "1"
    if key.endswith("_hz") and key not in effect.report_units:
        return "Hz"
    kinds = {p.name: p.kind for p in effect.parameters}
    kind = kinds.get(key, kinds.get(f"{key.removesuffix('s')} 0", effect.parameters[0].kind))
    unit = effect.report_units.get(key, effect.variant_units.get(placed.variant, UNITS[kind]))
    locations = [part.location for part in placed.parts if key.endswith(f" {part.location}")]
    place = locations[0] if locations else placed.location
    name = f"({place})" if place and " " in place else place
    return unit.format(q=name or "q", u=name or "u")


def list_published_parameters(
    placed: PlacedEffect, x: Float64[np.ndarray, " k"], record: Dataset
) -> dict[str, Any]:
    """Parameters of an effect for unknowns ``x`` by published key; times are on the clocks of their files."""
    effect, named = placed.effect, placed.name_parameters(x)
    fitted: dict[str, Any] = {p.name: named[p.name] for p in effect.parameters if p.reported}
    published = effect.report_parameters(fitted, placed) if effect.report_parameters else fitted
    if "times" in published:
        places = [record.to_file_time(time) for time in published["times"]]
        published["times"] = [time for _, time in places]
        if len(record.files) > 1:
            published["files"] = [number for number, _ in places]
    return published


@dataclass(frozen=True)
class ProfileLikelihood:
    """Log likelihood [nat], relative to the best fit, at ``values`` of a parameter in its ``unit``."""

    effect: str
    parameter: str
    unit: str
    values: Float64[np.ndarray, " n"]
    log_likelihood: Float64[np.ndarray, " n"]


def compute_profiles(
    problem: EstimationProblem, hypothesis: HypothesisFit, *, noise_inflation: float
) -> Iterator[ProfileLikelihood]:
    """Profile likelihoods of the first scalar parameters of a hypothesis' effects.

    Source: profile likelihood, Raue et al., 2009, doi:10.1093/bioinformatics/btp358.
    """
    if not np.isfinite(hypothesis.fit.curvature).all():
        return
    hypothesis, record = replace(hypothesis, effects=hypothesis.fitted), problem.dataset
    prior = make_joint_prior(hypothesis.effects, problem.rollout_model)
    deviation = compute_posterior_deviations(hypothesis.fit, prior, noise_inflation)
    count = 0
    for placed in hypothesis.effects:
        cut = hypothesis.parameter_slice(placed)
        keys = list_published_parameters(placed, hypothesis.fit.x[cut], record)
        for i, parameter in enumerate(placed.effect.parameters):
            if parameter.name not in keys or count == PROFILES.max_parameters:
                continue
            count += 1
            at = cut.start + i
            x, fall = _profile_parameter(problem, hypothesis, at, deviation[at], noise_inflation)
            rows = np.repeat(hypothesis.fit.x[None, cut], len(x), axis=0)
            rows[:, i] = x
            values = [list_published_parameters(placed, row, record)[parameter.name] for row in rows]
            unit = format_parameter_unit(placed, parameter.name)
            yield ProfileLikelihood(placed.effect.name, parameter.name, unit, np.array(values), fall)


def _profile_parameter(
    problem: EstimationProblem, hypothesis: HypothesisFit, at: int, spread: float, noise_inflation: float
) -> tuple[np.ndarray, np.ndarray]:
    """Values of one parameter on both sides of the best, and the log likelihood of the best fit at each."""
    best, prior = hypothesis.fit, problem.prior(hypothesis.effects)
    brief = replace(problem, iterations=PROFILES.iterations)
    rows = [(best.x[at], 0.0)]
    for side in (-1.0, 1.0):
        x, starts = best.x, best.starts
        for k in range(1, PROFILES.points_per_side + 1):
            reach = side * PROFILES.reach_deviations * spread * k / PROFILES.points_per_side
            value = max(best.x[at] + reach, prior.lowest[at])
            if value == x[at]:
                break
            pinned = replace(prior, mean=prior.mean.copy(), deviation=prior.deviation.copy())
            pinned.mean[at], pinned.deviation[at] = value, PROFILES.pin_deviation * spread
            moved = x.copy()
            moved[at] = value
            fit = brief.fit(hypothesis.effects, moved, starts, hypothesis.nearby_slopes, pinned)
            x, starts = fit.x, fit.starts
            penalty = float(shooting.compute_penalty(fit.x[None], prior)[0])
            by_prior = 0.5 * (penalty - best.penalty) / problem.noise_inflation
            loss = 0.5 * (fit.misfit - best.misfit) / noise_inflation + by_prior
            rows.append((float(value), -loss))
    rows.sort()
    values, fall = np.array(rows).T
    return values, fall


@dataclass(frozen=True)
class Separability:
    """Expected log Bayes factor (n, n) of the effect of a row over that of a column [nat]."""

    names: tuple[str, ...]
    nats: Float64[np.ndarray, "n n"]


def compute_separability(
    problem: EstimationProblem, found: Sequence[HypothesisFit], *, noise_inflation: float
) -> Separability | None:
    """Compare the best fits of single effects; None if fewer than two change the motion.

    The change by one effect is regressed on the derivatives by another one, by the nuisance parameters and by
    the initial states. Half of the square that remains, over ``noise_inflation``, is the expected log Bayes
    factor.
    """
    best: dict[str, HypothesisFit] = {}
    for hypothesis in found:
        fit = hypothesis.fit
        # an effect that changes nothing, or overflows, has no derivatives to regress on
        finite = np.isfinite(fit.slopes).all() and np.isfinite(fit.start_slopes).all()
        if len(hypothesis.fitted) == len(hypothesis.effects) == 1 and finite:
            best.setdefault(hypothesis.name, hypothesis)
    fits = list(best.values())[: PROFILES.max_compared_effects]
    if len(fits) < 2:
        return None
    signatures = [_effect_signature(problem, hypothesis) for hypothesis in fits]
    squares = [[_unexplained_square(problem, row, other) for other in fits] for row in signatures]
    names = tuple(hypothesis.name for hypothesis in fits)
    return Separability(names, np.array(squares) / (2.0 * noise_inflation))


def _effect_signature(problem: EstimationProblem, hypothesis: HypothesisFit) -> Float64[np.ndarray, "W L d"]:
    """Change of the motion by the effect alone, over the noise: to first order in its amplitudes.

    Of an effect without amplitudes, as a delay, it is the full change.
    """
    amplitudes = hypothesis.effects[0].effect.amplitudes
    if len(amplitudes):
        change = hypothesis.fit.slopes[..., amplitudes] @ hypothesis.fit.x[amplitudes]
        return change.reshape(problem.data.y.shape)
    x, starts = hypothesis.fit.x[None], hypothesis.fit.starts[None]
    with_it = problem.predict(hypothesis.effects)(x, starts)[0]
    without = problem.predict(())(x[:, hypothesis.n_effect_parameters :], starts)[0]
    return np.nan_to_num((with_it - without) * problem.data.weight)


def _unexplained_square(problem: EstimationProblem, change: np.ndarray, other: HypothesisFit) -> float:
    """What regression of a ``change`` on the ``other`` effect and all nuisance parameters leaves, squared."""
    fit = other.fit
    deviation = make_joint_prior(other.effects, problem.rollout_model).deviation
    left = shooting.eliminate_starts(change, fit.slopes, fit.start_slopes)
    start_moves = left.follow(np.zeros(len(left.right)))
    # the effect itself has a flat prior, the nuisance parameters keep theirs
    of_effect = np.arange(len(deviation)) < other.n_effect_parameters
    precision = np.where(of_effect, 1e-9 * np.diag(left.curvature), 1.0 / deviation**2)
    move = np.linalg.lstsq(left.curvature + np.diag(precision), left.right, rcond=1e-12)[0]
    rest = change.reshape(len(change), -1) - np.einsum("wms,ws->wm", fit.start_slopes, start_moves)
    return max(float(np.sum(rest**2)) - float(left.right @ move), 0.0)
