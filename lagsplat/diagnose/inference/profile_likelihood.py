"""Fitted parameters with units, intervals and profile likelihoods, and which effects could be separated."""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.core.config import PROFILES
from lagsplat.diagnose.core.result import Parameter
from lagsplat.diagnose.effects.base import PlacedEffect, SampleEffect
from lagsplat.diagnose.effects.parameters import UNITS
from lagsplat.diagnose.estimation.dataset import Dataset
from lagsplat.diagnose.estimation.multiple_shooting import (
    compute_penalty,
    eliminate_starts,
    fit_multiple_shooting,
)
from lagsplat.diagnose.inference.posterior import compute_laplace_interval
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit, make_joint_prior


def estimate_parameters(
    problem: EstimationProblem, hypothesis: HypothesisFit, placed: PlacedEffect, noise_inflation: float
) -> dict[str, Parameter]:
    """The parameters of one effect of a hypothesis in physical units, with 90 % intervals.

    Returns:
        The parameters by the keys that ``diagnosis.json`` uses.
    """
    effect, scales = placed.effect, placed.scales
    kinds = {p.name: p.kind for p in effect.parameters}
    if isinstance(effect, SampleEffect):
        sized = {
            name: [v * scales.of(kinds[name]) for v in values] for name, values in hypothesis.noise.items()
        }
        return {name: Parameter(v[0], v[1], v[2], UNITS[kinds[name]]) for name, v in sized.items()}
    known = [e for e in hypothesis.effects if not isinstance(e.effect, SampleEffect)]
    prior = [p.prior for e in known for p in e.effect.parameters]
    low, high = compute_laplace_interval(
        replace(hypothesis, effects=tuple(known)),
        problem.rollout_model.nuisance.deviation,
        prior,
        noise_inflation,
    )
    cut = hypothesis.parameter_slice(placed)
    rows = placed.to_physical(np.stack([hypothesis.fit.x[cut], low[cut], high[cut]]))
    best, *ends = (list_published_parameters(placed, row, problem.rollout_model.dataset) for row in rows)
    out = {}
    for key, value in best.items():
        first, second = (end.get(key, value) for end in ends)
        if isinstance(value, list) and not len(first) == len(second) == len(value):
            first = second = value
        elif not isinstance(value, list) and first > second:
            first, second = second, first
        out[key] = Parameter(value, first, second, format_parameter_unit(placed, key))
    return out


def format_parameter_unit(placed: PlacedEffect, key: str) -> str:
    """Unit of a published parameter: its kind's, or that of the first in a list, or that of the first
    parameter."""
    kinds = {p.name: p.kind for p in placed.effect.parameters}
    if key == "files":
        return "1"
    if key in placed.effect.report_units:
        return placed.effect.report_units[key]
    if key.endswith("_hz"):
        return "Hz"
    first = placed.effect.parameters[0].kind
    raw = UNITS[kinds.get(key, kinds.get(f"{key.removesuffix('s')} 0", first))]
    raw = placed.effect.variant_units.get(placed.variant, raw)
    place = next(
        (part.location for part in placed.parts if key.endswith(f" {part.location}")), placed.location
    )
    name = f"({place})" if place and " " in place else place
    return raw.format(q=name or "q", u=name or "u")


def list_published_parameters(placed: PlacedEffect, row: np.ndarray, record: Dataset) -> dict[str, Any]:
    """Physical values of an effect's parameters by published key; times are on the clocks of their files."""
    effect = placed.effect
    plain = {
        p.name: float(np.exp(value) if p.kind == "log_ratio" else value)
        for p, value in zip(effect.parameters, row, strict=True)
        if not p.name.startswith("memory ")
    }
    published: dict[str, Any] = (
        effect.report_parameters(plain, placed) if effect.report_parameters else dict(plain)
    )
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
    effects = tuple(e for e in hypothesis.effects if not isinstance(e.effect, SampleEffect))
    if not np.isfinite(hypothesis.fit.curvature).all():
        return
    curvature = hypothesis.fit.curvature / noise_inflation + np.diag(
        1.0 / make_joint_prior(effects, problem.rollout_model).deviation ** 2
    )
    spread = np.sqrt(np.maximum(np.diag(np.linalg.pinv(curvature)), 0.0))
    count = 0
    for placed in effects:
        cut = hypothesis.parameter_slice(placed)
        keys = list_published_parameters(
            placed, placed.to_physical(hypothesis.fit.x[None, cut])[0], problem.rollout_model.dataset
        )
        for i, parameter in enumerate(placed.effect.parameters):
            if parameter.name not in keys or count == PROFILES.max_parameters:
                continue
            count += 1
            at = cut.start + i
            x, fall = _profile_parameter(
                problem, replace(hypothesis, effects=effects), at, spread[at], noise_inflation
            )
            rows = np.repeat(hypothesis.fit.x[None, cut], len(x), axis=0)
            rows[:, i] = x
            physical = placed.to_physical(rows)
            values = [
                list_published_parameters(placed, row, problem.rollout_model.dataset)[parameter.name]
                for row in physical
            ]
            where = format_parameter_unit(placed, parameter.name)
            yield ProfileLikelihood(placed.effect.name, parameter.name, where, np.array(values), fall)


def _profile_parameter(
    problem: EstimationProblem, hypothesis: HypothesisFit, at: int, spread: float, noise_inflation: float
) -> tuple[np.ndarray, np.ndarray]:
    """Values of one parameter on both sides of the best, and the log likelihood of the best fit at each."""
    best, prior = hypothesis.fit.x[at], problem.prior(hypothesis.effects)
    near = (hypothesis.fit.slopes[..., hypothesis.n_effect_parameters :], hypothesis.fit.start_slopes)
    rows = [(best, 0.0)]
    for side in (-1.0, 1.0):
        x, starts = hypothesis.fit.x, hypothesis.fit.starts
        for k in range(1, PROFILES.points_per_side + 1):
            value = max(
                best + side * PROFILES.reach_deviations * spread * k / PROFILES.points_per_side,
                prior.lowest[at],
            )
            if value == x[at]:
                break
            mean, deviation = prior.mean.copy(), prior.deviation.copy()
            mean[at], deviation[at] = value, PROFILES.pin_deviation * spread
            pinned = replace(prior, mean=mean, deviation=deviation)
            moved = x.copy()
            moved[at] = value
            fit = fit_multiple_shooting(
                problem.predict(hypothesis.effects),
                moved,
                starts,
                problem.data,
                pinned,
                iterations=PROFILES.iterations,
                tolerance=problem.tolerance,
                known=near,
            )
            x, starts = fit.x, fit.starts
            paid = float(compute_penalty(fit.x[None], prior)[0])
            priced = 0.5 * (paid - hypothesis.fit.penalty) / problem.noise_inflation
            lost = 0.5 * (fit.misfit - hypothesis.fit.misfit) / noise_inflation + priced
            rows.append((float(value), -lost))
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
        # an effect that changes nothing, or overflows, has no derivatives to regress on
        lone = len(hypothesis.effects) == 1 and not isinstance(hypothesis.effects[0].effect, SampleEffect)
        if (
            lone
            and np.isfinite(hypothesis.fit.slopes).all()
            and np.isfinite(hypothesis.fit.start_slopes).all()
        ):
            best.setdefault(hypothesis.effects[0].effect.name, hypothesis)
    fits = list(best.values())[: PROFILES.max_compared_effects]
    if len(fits) < 2:
        return None
    marks = [_effect_signature(problem, hypothesis) for hypothesis in fits]
    nats = np.array([[_unexplained_square(problem, mark, other) for other in fits] for mark in marks]) / (
        2.0 * noise_inflation
    )
    return Separability(tuple(hypothesis.effects[0].effect.name for hypothesis in fits), nats)


def _effect_signature(problem: EstimationProblem, hypothesis: HypothesisFit) -> Float64[np.ndarray, "W L d"]:
    """Change of the motion by the effect alone, over the noise: to first order in its amplitudes.

    Of an effect without amplitudes, as a delay, it is the full change.
    """
    amplitudes = hypothesis.effects[0].effect.amplitudes
    if amplitudes:
        change = hypothesis.fit.slopes[..., :amplitudes] @ hypothesis.fit.x[:amplitudes]
        return change.reshape(problem.data.y.shape)
    x, starts = hypothesis.fit.x[None], hypothesis.fit.starts[None]
    with_it = problem.predict(hypothesis.effects)(x, starts)[0]
    without = problem.predict(())(x[:, hypothesis.n_effect_parameters :], starts)[0]
    return np.nan_to_num((with_it - without) * problem.data.weight)


def _unexplained_square(problem: EstimationProblem, mark: np.ndarray, other: HypothesisFit) -> float:
    """The square of ``mark`` that regression on the ``other`` effect and on all nuisance parameters
    leaves."""
    fit = other.fit
    spread = make_joint_prior(other.effects, problem.rollout_model).deviation
    curvature, gradient, _, _, start_moves = eliminate_starts(mark, fit.slopes, fit.start_slopes)
    flat = mark.reshape(len(mark), -1)
    # the effect itself has a flat prior, the nuisance parameters keep theirs
    precision = np.where(
        np.arange(len(spread)) < other.n_effect_parameters, 1e-9 * np.diag(curvature), 1.0 / spread**2
    )
    move = np.linalg.lstsq(curvature + np.diag(precision), gradient, rcond=1e-12)[0]
    started = float(np.sum((flat - np.einsum("wms,ws->wm", fit.start_slopes, start_moves)) ** 2))
    return max(started - float(gradient @ move), 0.0)
