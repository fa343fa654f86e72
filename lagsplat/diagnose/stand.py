"""A sim beside a real recording, ready to be compared."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Bool, Float64

from lagsplat.diagnose.compare import Contest, belief, pushed
from lagsplat.diagnose.config import DiagnoseConfig
from lagsplat.diagnose.disturbed import LEAST, MISSED, undisturbed
from lagsplat.diagnose.familiar import Familiar
from lagsplat.diagnose.forms import COEFFICIENTS
from lagsplat.diagnose.frozen import frozen
from lagsplat.diagnose.identify import Setting, identify
from lagsplat.diagnose.model import Model
from lagsplat.diagnose.nuisance import Nuisance
from lagsplat.diagnose.prepare import Prepared, prepare, rough_period_s
from lagsplat.diagnose.record import Span, Windows, apart, cut_windows, spans
from lagsplat.diagnose.shoot import derivatives, eliminate
from lagsplat.diagnose.simulate import Bench
from lagsplat.io.motion import Motion

LOST = 50.0
"""Mean square residual, in units of the noise, beyond which a window is too long to be followed."""
SHORTER, SHORTEST = 0.35, 0.12
"""Shares of a window that can be followed past an unstable rest, as an upright pendulum's."""
TOLERANCE = 1e-4
"""Gain of a step below which a sim's own fit has ended, as a share of the misfit."""
MOSTLY = 0.7
"""Share of the windows that must be familiar for the others to be left aside."""
OPEN = 6
"""Directions at most that the sim's identification leaves open."""


@dataclass(frozen=True)
class Sim:
    """A model and what is not known about it."""

    model: Model
    freedom: Float64[np.ndarray, "R K"]
    """Changes of all coefficients of one standard deviation each."""
    misfit: float
    """Mean square residual on its own recordings in units of their noise."""
    correlation: float = 1.0
    """Samples of that residual that count as one."""
    reach: float = 1.0
    """How far ahead it can be run, in windows as long as the settings say."""
    given: "Sim | None" = None
    """As it was handed over, where it was moved since (`recalibrated`)."""
    familiar: Familiar | None = None
    """How it was seen to move, if other stretches are to be left aside."""
    disturbed: tuple[Span, ...] = ()
    """Stretches of its own recordings that no law tells beside the others, and that were left out."""
    cost: float = np.nan
    """Bayesian information criterion of a law that was found, beside others of the same recordings."""

    @classmethod
    def exact(cls, model: Model) -> "Sim":
        """A sim that is given, so that nothing about it was estimated."""
        size = sum(getattr(model, name).size for name in COEFFICIENTS)
        return cls(model, np.zeros((0, size)), 1.0)


@dataclass(frozen=True)
class Periods:
    """Natural periods of the sim about rest [s]; the rms period of the motion where it has none."""

    longest_s: float
    shortest_s: float


def sim_of(motions: Sequence[Motion], config: DiagnoseConfig) -> Sim:
    """The sim that made these recordings.

    Raises:
        ValueError: nothing moves, or no clip is long enough for a window.
    """
    period_s = rough_period_s(motions)
    ready = prepare(motions, period_s=period_s)
    again = partial(
        identify, ready.record, ready.smooth, ready.sigma, period_s, setting_of(config),
        held=config.input_hold == "zoh",
    )  # fmt: skip

    def told(reach: float, without: tuple[Span, ...] = ()) -> Sim:
        length_s = reach * config.window_periods * period_s
        windows = cut_windows(ready.record, length_s=length_s, least=12)
        kept = apart(windows, ready.record, without)
        if len(kept.first) >= LEAST:
            windows = kept
        found, odd = undisturbed(again(windows), again)
        all_odd = (*without, *spans(odd, ready.record))
        model = rested(found.model, ready.smooth)
        return Sim(model, found.freedom, found.misfit, reach=reach, disturbed=all_odd, cost=found.cost)

    whole = told(1.0)
    if whole.misfit < LOST:
        return whole
    short = told(SHORTEST)  # tells best where something else acted
    middle = told(SHORTER, short.disturbed)
    for one in (middle, short):
        if one.misfit < MISSED:
            return one
    return min(whole, middle, key=lambda one: one.misfit)


def setting_of(config: DiagnoseConfig) -> Setting:
    """How a sim is fitted to its own recordings."""
    ridge, iterations = config.identify_ridge, config.identify_iterations
    return Setting(config.steps_per_period, ridge, iterations, TOLERANCE)


def rested(model: Model, q: Float64[np.ndarray, "N d"]) -> Model:
    """The model at rest where its potential is lowest along the motion, if its rest is unstable."""
    if np.linalg.eigvalsh(model.stiffness).min() > 0.0:
        return model
    return replace(
        model,
        rest=q[int(np.argmin(model.basis.first(len(model.potential)).values(q) @ model.potential))].copy(),
    )


def periods(model: Model, fallback_s: float) -> Periods:
    """Natural periods by stiffness and inertia at rest, no further than threefold from the motion's."""
    values = np.linalg.eigvals(np.linalg.solve(model.inertia, model.stiffness)).real
    values = values[values > 0.0]
    if not len(values):
        return Periods(fallback_s, fallback_s)
    low, high = (float(2.0 * np.pi / np.sqrt(values.min())), float(2.0 * np.pi / np.sqrt(values.max())))
    return Periods(
        min(max(low, fallback_s / 3.0), 3.0 * fallback_s), min(max(high, fallback_s / 5.0), fallback_s * 3.0)
    )


def stand(sim: Sim, real: Sequence[Motion], config: DiagnoseConfig) -> tuple[Contest, Prepared, Periods]:
    """The contest of all hypotheses about ``real``."""
    model = sim.model
    natural = periods(model, rough_period_s(real))
    ready = prepare(real, period_s=natural.shortest_s)
    record = ready.record
    omega = 2.0 * np.pi / natural.longest_s
    force = np.var(record.v, axis=0) / np.maximum(np.std(ready.smooth, axis=0), 1e-12)
    nuisance = Nuisance(
        config.potential,
        config.damping * omega,
        config.inputs,
        config.offset * force,
        config.warp,
        record.u.shape[1],
        sim.freedom,
    )
    steps = max(1, int(np.ceil(record.dt_s * config.steps_per_period / natural.shortest_s)))
    reach_s = config.window_periods * sim.reach * natural.longest_s
    windows = cut_windows(record, length_s=reach_s, least=20)
    if len(windows.first) < 4:
        windows = cut_windows(record, length_s=natural.longest_s, least=20)
    like = familiar(sim, windows, ready)
    aside, windows = int(np.count_nonzero(~like)), windows.only(like)
    bench = Bench(model, record, nuisance, steps, config.input_hold == "zoh", ready.smooth)
    late = frozen(record.q, record.clips, ready.sigma)
    price = max(sim.misfit, 1.0) * sim.correlation
    contest = Contest(bench, windows, ready.sigma, config.iterations, config.tolerance, late, price, aside)
    kept = relevant(contest, sim.freedom)
    return replace(contest, bench=replace(bench, nuisance=replace(nuisance, directions=kept))), ready, natural


def familiar(sim: Sim, windows: Windows, ready: Prepared) -> Bool[np.ndarray, " W"]:
    """Windows in which it moves as the sim was seen to; all, if most are not such or it does not ask."""
    if sim.familiar is None:
        return np.ones(len(windows.first), dtype=bool)
    like = sim.familiar.among(windows, ready.smooth, ready.record)
    return like if like.sum() > MOSTLY * len(like) else np.ones_like(like)


def relevant(contest: Contest, freedom: Float64[np.ndarray, "R K"]) -> Float64[np.ndarray, "r K"]:
    """The few combinations of open directions that this recording can see at all, the most visible first."""
    if not len(freedom):
        return freedom
    prior, n = belief((), contest.bench), contest.bench.nuisance.size
    step = prior.step.copy()
    step[n - len(freedom) :] = 0.1
    residual, slopes, begun = derivatives(contest.predict(()), np.zeros(n), contest.begun, contest.data, step)
    curvature, *_ = eliminate(residual, slopes, begun)
    values, vectors = np.linalg.eigh(curvature[n - len(freedom) :, n - len(freedom) :])
    chosen = np.argsort(values)[::-1][:OPEN]
    return vectors[:, chosen[values[chosen] > 0.3]].T @ freedom


def held_to(sim: Sim, motions: Sequence[Motion], config: DiagnoseConfig) -> Sim:
    """A given sim with the misfit, and its correlation, that it leaves of the recordings it is true to.

    What a sim has wrong stays wrong for a part of a period, so that many samples count as one. Of long
    recordings as much is looked at as `own_longest_s` says, here and there.
    """
    contest, _, _ = stand(sim, motions, config)
    frames = config.own_longest_s / contest.bench.record.dt_s
    return measured(sim, replace(contest, windows=contest.windows.evenly(frames)))


def measured(sim: Sim, contest: Contest) -> Sim:
    """The sim with its misfit, and its correlation, on the windows of a contest with its own motion."""
    still, length = np.zeros(contest.bench.nuisance.size), contest.windows.length
    fit = contest.fit((), still)
    # what is wrong for long is cheaper to leave than to follow, which shows only once it is known
    price = max(fit.misfit / contest.freedom, 1.0) * correlation(fit.residual, length)
    fit = replace(contest, price=price).fit((), still)
    left = (fit.misfit + pushed(fit, price)) / contest.freedom
    return replace(sim, misfit=left, correlation=correlation(fit.residual, length))


def correlation(residual: Float64[np.ndarray, "W L d"], length: np.ndarray) -> float:
    """Samples that count as one: the sum of the autocorrelation up to its first zero, both ways.

    Source: the integrated autocorrelation time with the initial positive sequence (Geyer 1992).
    """
    power = float(sum((row[:n] ** 2).sum() for row, n in zip(residual, length, strict=True)))
    total = 1.0
    for lag in range(1, residual.shape[1]):
        rows = [row[: n - lag] * row[lag:n] for row, n in zip(residual, length, strict=True) if n > lag]
        share = float(sum(row.sum() for row in rows)) / max(power, 1e-300)
        if share <= 0.0:
            break
        total += 2.0 * share
    return total
