"""Which experiment to do next: the one that separates the two leading hypotheses most, per second."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import partial
from itertools import islice
from math import ceil

import numpy as np

from lagsplat.diagnose.core.config import EXPERIMENT
from lagsplat.diagnose.core.result import Candidate, NextExperiments, Suggestion
from lagsplat.diagnose.effects.registry import short_title
from lagsplat.diagnose.experiment.candidates import Experiment, RecordedRange, propose_experiments
from lagsplat.diagnose.experiment.separation import (
    FittedHypothesis,
    Separation,
    compute_separation,
    simulate_experiment,
)
from lagsplat.diagnose.inference.model_selection import ModelRanking
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit, make_joint_prior


@dataclass(frozen=True)
class LeadingPair:
    """Two hypotheses after the recordings so far, and how an experiment weighs them."""

    problem: EstimationProblem
    fits: tuple[FittedHypothesis, FittedHypothesis]
    names: tuple[str, str]
    separate: Callable[..., Separation]
    """``separate(truth, rival, experiment, refit_steps=...)``: `compute_separation` for this problem."""

    def compare(self, experiment: Experiment, *, refit_steps: int) -> tuple[Separation, Separation]:
        """The separation of either fit from the other one."""
        one, other = self.fits
        return (
            self.separate(one, other, experiment, refit_steps=refit_steps),
            self.separate(other, one, experiment, refit_steps=refit_steps),
        )

    def compare_draws(
        self, experiment: Experiment, rng: np.random.Generator
    ) -> tuple[Separation, Separation]:
        """The same for parameters drawn from both fits.

        A draw that is off the fit costs its own hypothesis something as well, which is subtracted.
        """
        out = []
        for fit, other in (self.fits, self.fits[::-1]):
            drawn = fit.draw(rng, make_joint_prior(fit.effects, self.problem.rollout_model).lowest)
            own, away = (self.separate(drawn, rival, experiment) for rival in (fit, other))
            out.append(replace(away, nats=away.nats - own.nats))
        return out[0], out[1]

    def stays_in_range(self, experiment: Experiment) -> bool:
        """Whether the motion stays in the visited range, whichever hypothesis is true."""
        span, d = RecordedRange.of(self.problem.dataset), self.problem.dataset.d
        states = (simulate_experiment(self.problem, fit, experiment)[1] for fit in self.fits)
        return all(span.holds(each[:, :d]) for each in states)


def select_leaders(
    candidates: Sequence[Candidate], ranking: ModelRanking, chosen: HypothesisFit
) -> tuple[HypothesisFit, ...]:
    """The fits of the two most probable hypotheses; effects that were chosen together are one.

    `unknown` predicts nothing, so that the two nearest effects stand for it. Empty where an effect on single
    samples leads, or where there are not two: no experiment tells more of those.
    """
    together = {placed.effect.name for placed in chosen.effects}
    leaders: list[HypothesisFit] = []
    for name in (candidate.name for candidate in candidates if candidate.probability > 0.0):
        fit = ranking.none if name == "none" else chosen if name in together else ranking.best_fit(name)
        usable = fit is not None and np.isfinite(fit.fit.curvature).all()
        if fit is not None and usable and not any(fit is other for other in leaders):
            leaders.append(fit)
        if len(leaders) == 2:
            break
    return tuple(leaders) if len(leaders) == 2 and not any(fit.moves_samples for fit in leaders) else ()


def plan_experiments(
    problem: EstimationProblem,
    leaders: Sequence[HypothesisFit],
    *,
    noise_inflation: float,
    window_s: float,
    q_names: Sequence[str],
    u_names: Sequence[str],
) -> NextExperiments:
    """Suggest at most `EXPERIMENT.suggestions` experiments that separate the two ``leaders``.

    Of each kind the best is taken, by its separation per second with the parameters as fitted and a linear
    refit, either hypothesis being true; the best kinds are then judged by a few steps of a refit, with
    parameters drawn from both fits. ``noise_inflation`` is a factor on the noise variance [1], ``window_s``
    the length of the windows [s] that a diagnosis of a new recording would have.
    """
    first, second = (FittedHypothesis.of(problem, fit, noise_inflation=noise_inflation) for fit in leaders)
    names = _name_hypothesis(first), _name_hypothesis(second)
    separate = partial(compute_separation, problem, noise_inflation=noise_inflation, window_s=window_s)
    pair = LeadingPair(problem, (first, second), names, separate)
    channels = [e.channel for h in pair.fits for e in h.effects if e.channel is not None]
    best: dict[str, tuple[float, Experiment]] = {}
    model, record = problem.rollout_model.model, problem.dataset
    for versions in propose_experiments(model, record, period_s=problem.period_s, channels=channels):
        for experiment in islice(filter(pair.stays_in_range, versions), EXPERIMENT.versions):
            rate = sum(each.nats for each in pair.compare(experiment, refit_steps=1)) / experiment.duration_s
            if experiment.kind not in best or rate > best[experiment.kind][0]:
                best[experiment.kind] = rate, experiment
    rated = [experiment for _, experiment in sorted(best.values(), key=lambda row: -row[0])]
    suggestions = [_suggest(pair, each, q_names, u_names) for each in rated[: EXPERIMENT.suggestions]]
    suggestions.sort(key=lambda each: -each.nats / each.duration_s)
    kept = tuple(each for each in suggestions if each.nats >= EXPERIMENT.bare)
    return NextExperiments(names, kept, "" if kept else _explain_none(names, suggestions))


def _name_hypothesis(hypothesis: FittedHypothesis) -> str:
    if not hypothesis.effects:
        return "the simulation alone"
    places = {effect.location for effect in hypothesis.effects if effect.location}
    name = " with ".join(short_title(name) for name in hypothesis.names)
    return f"{name} ({', '.join(sorted(places))})" if places else name


def _suggest(
    pair: LeadingPair, experiment: Experiment, q_names: Sequence[str], u_names: Sequence[str]
) -> Suggestion:
    """One experiment with its separation over draws of both hypotheses' parameters."""
    problem, names = pair.problem, pair.names
    draws = (pair.compare_draws(experiment, np.random.default_rng(k)) for k in range(EXPERIMENT.draws))
    rows = [pair.compare(experiment, refit_steps=EXPERIMENT.refit_steps), *draws]
    nats = [0.5 * (one.nats + other.nats) for one, other in rows]
    seen, at = max(((row[i], i) for row in rows for i in (0, 1)), key=lambda pick: pick[0].nats)
    own, other = seen.expected
    mean = float(np.mean(nats))
    repeats = max(1, ceil(EXPERIMENT.decisive / max(mean, 1e-9)))
    suggestion = Suggestion(
        kind=experiment.kind,
        text="",
        duration_s=experiment.duration_s,
        nats=mean,
        low=float(min(nats)),
        high=float(max(nats)),
        repeats=repeats,
        coordinate=q_names[seen.coordinate],
        time_s=seen.time_s,
        expected=(other, own) if at else (own, other),
        start={
            name: float(q) if abs(q) > sigma else 0.0
            for name, q, sigma in zip(q_names, experiment.start, problem.sigma, strict=True)
        },
        input={"t": experiment.time_s} | dict(zip(u_names, experiment.u.T, strict=True)),
    )
    noise = float(problem.sigma[seen.coordinate])
    return replace(suggestion, text=_describe(suggestion, experiment, names, noise))


def _describe(each: Suggestion, experiment: Experiment, names: tuple[str, ...], noise: float) -> str:
    """What to do, for how long, by how much it separates, and which observation decides."""
    varied = [name for name, u in each.input.items() if name != "t" and np.ptp(u) > 0.0]
    ranges = [f"{name} from {min(each.input[name]):.3g} to {max(each.input[name]):.3g}" for name in varied]
    pose = ", ".join(f"{name} = {value:.3g}" for name, value in each.start.items())
    what = f"{experiment.what} of {' and '.join(ranges)}, from rest at {pose}"
    if not varied:
        load = f", which adds {experiment.payload:.0%} to the inertia" if experiment.payload else ""
        what = f"{experiment.what}{load}, at {pose}"
    again = f", {each.repeats} times over" if each.repeats > 1 else ""
    first, second = each.expected
    return (
        f"Record {what}, for {each.duration_s:.3g} s{again}: one such recording is expected to separate "
        f"{names[0]} from {names[1]} by {each.nats:.3g} nats (from {each.low:.3g} to {each.high:.3g} by the "
        f"uncertainty of both fits). {each.coordinate} at {each.time_s:.3g} s tells most: {first:.4g} with "
        f"{names[0]}, {second:.4g} with {names[1]}, at a noise of {noise:.2g}"
    )


def _explain_none(names: tuple[str, ...], tried: Sequence[Suggestion]) -> str:
    """That no experiment separates two hypotheses."""
    most = max((each.nats for each in tried), default=0.0)
    return (
        f"No experiment within the recorded inputs and {EXPERIMENT.reach:g} times the visited range tells "
        f"{names[0]} from {names[1]}: the best is expected to do so by {most:.2g} nats, and at least "
        f"{EXPERIMENT.bare:g} are asked for. There both move alike, so that either may stand for the other"
    )
