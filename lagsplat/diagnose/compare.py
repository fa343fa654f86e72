"""Hypotheses against a record: which effects can explain it, and how well each does.

A quick score test ranks all of them; the best are fitted by shooting; evidence compares the fits.
"""

import itertools
from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from functools import cached_property

import numpy as np
from jaxtyping import Bool, Float64

from lagsplat.diagnose.effects.effect import Instance, Noise
from lagsplat.diagnose.prior import HalfNormal
from lagsplat.diagnose.record import Windows
from lagsplat.diagnose.shoot import Belief, Data, Fit, derivatives, eliminate, shoot
from lagsplat.diagnose.simulate import Bench

PAID = 40.0
"""Square of the moved uncertainties, over their price, that is no longer believed."""


@dataclass(frozen=True)
class Contest:
    """A bench, the windows to be explained, and the noise (d,) of a sample."""

    bench: Bench
    windows: Windows
    sigma: Float64[np.ndarray, " d"]
    iterations: int
    tolerance: float
    late: Bool[np.ndarray, " N"] | None = None
    """Samples that repeat an earlier one, on which nothing is fitted."""
    price: float = 1.0
    """Of a moved parameter, in units of what it costs beside white noise: what a sim leaves of its own
    recordings weighs less than noise does, in fits as in evidence."""
    aside: int = 0
    """Windows that are not looked at, for the sim was never seen to move so."""

    @cached_property
    def repeats(self) -> Bool[np.ndarray, "W L"]:
        """Where the windows hold such samples."""
        inside = self.windows.mask() > 0.0
        return np.zeros_like(inside) if self.late is None else inside & self.windows.take(self.late)

    @cached_property
    def data(self) -> Data:
        """The windows' samples in units of the noise."""
        record = self.bench.record
        return Data(
            self.windows.take(record.q),
            (self.windows.mask() * ~self.repeats)[..., None] / self.sigma,
            1e-4 * np.concatenate([np.std(record.q, axis=0), np.std(record.v, axis=0)]),
        )

    @property
    def freedom(self) -> float:
        """Samples less what the starts take."""
        w, d = self.windows, self.bench.record.d
        return float((w.length.sum() - self.repeats.sum()) * d - 2 * d * len(w.first))

    @cached_property
    def begun(self) -> np.ndarray:
        """Where the windows start by the smoothed record, (W, 2 d)."""
        return np.concatenate([self.bench.smooth, self.bench.record.v], axis=1)[self.windows.first]

    def predict(self, effects: Sequence[Instance]) -> Callable[[np.ndarray, np.ndarray], np.ndarray]:
        """Predictions of a set of effects."""
        return lambda x, starts: self.bench.rollouts(effects, x, starts, self.windows)[0]

    def belief(self, effects: Sequence[Instance]) -> Belief:
        """What fits hold of the unknowns beforehand."""
        prior = belief(effects, self.bench)
        return replace(prior, deviation=prior.deviation / np.sqrt(self.price))

    def fit(
        self,
        effects: Sequence[Instance],
        x: np.ndarray,
        starts: np.ndarray | None = None,
        known: tuple[np.ndarray, np.ndarray] | None = None,
    ) -> Fit:
        """The best parameters from ``x``, those of the effects followed by the uncertainties.

        ``known`` are slopes of a fit nearby by the uncertainties and by the starts.
        """
        return shoot(
            self.predict(effects), x, self.begun if starts is None else starts, self.data,
            self.belief(effects), iterations=self.iterations, tolerance=self.tolerance, known=known,
        )  # fmt: skip


def pushed(fit: Fit, price: float) -> float:
    """How much further a fit moved the uncertainties than is believed of them, in units of its misfit."""
    return max(fit.penalty - PAID * price, 0.0)


def belief(effects: Sequence[Instance], bench: Bench) -> Belief:
    """Prior of the unknowns of ``effects`` followed by the uncertainties."""
    priors = [p.prior for e in effects for p in e.effect.parameters]
    spare = bench.nuisance.deviation
    deviation = np.concatenate([[p.deviation for p in priors], spare])
    return Belief(
        np.concatenate([[p.mean for p in priors], np.zeros(len(spare))]),
        deviation,
        np.concatenate([[p.lowest for p in priors], np.full(len(spare), -np.inf)]),
        np.concatenate([1e-3 * np.minimum(deviation[: len(priors)], 1.0), 1e-2 * spare]),
    )


@dataclass(frozen=True)
class Lead:
    """What the score test promises of one effect: the misfit it takes away, and where to begin."""

    instance: Instance
    gain: float
    starts: tuple[np.ndarray, ...]
    """Unknowns of the effect to begin from, the best first."""


def screen(
    contest: Contest, effects: tuple[Instance, ...], fit: Fit, offers: Sequence[Instance]
) -> list[Lead]:
    """How much misfit each of ``offers`` would take away beside ``effects``, to first order; best first.

    Source: the score (Lagrange multiplier) test, Rao, 1948, doi:10.1017/S0305004100023987.
    """
    prior = contest.belief(effects)
    residual, slopes, begun = derivatives(
        contest.predict(effects), fit.x, fit.starts, contest.data, prior.step
    )
    leads = []
    for offer in offers:
        if isinstance(offer.effect, Noise):
            continue
        guesses, columns = _guesses(contest, effects, fit, offer)
        tried = []
        for guess, group in zip(guesses, columns, strict=True):
            gain, amount = _gain(fit, residual, slopes, begun, prior, group, offer)
            x = guess.copy()
            n = offer.effect.amplitudes
            if n:
                x[:n] = amount
            tried.append((gain, x))
        tried.sort(key=lambda row: -row[0])
        if tried:
            leads.append(Lead(offer, tried[0][0], tuple(x for _, x in tried[:3])))
    return sorted(leads, key=lambda lead: -lead.gain)


def _guesses(
    contest: Contest, effects: tuple[Instance, ...], fit: Fit, offer: Instance
) -> tuple[list[np.ndarray], list[np.ndarray]]:
    """Unknowns on a grid of shapes, and what each of their amplitudes changes, (W, M, amplitudes)."""
    effect = offer.effect
    shapes = [p.grid for p in effect.parameters[effect.amplitudes :]]
    grid = list(itertools.product(*shapes)) if offer.grid is None else list(offer.grid)
    n = effect.amplitudes
    guesses = [
        np.array([0.0] * n + [p.prior.unknown(g) for p, g in zip(effect.parameters[n:], point, strict=True)])
        for point in grid
    ]
    step = [0.01 * p.prior.deviation for p in effect.parameters[:n]]
    sets = []
    for guess in guesses:
        for i in range(max(n, 1)):
            x = guess.copy()
            if n:
                x[i] += step[i]
            sets.append(x)
    known = sum(len(e.effect.parameters) for e in effects)
    whole = np.stack([np.concatenate([fit.x[:known], x, fit.x[known:]]) for x in sets])
    starts = np.repeat(fit.starts[None], len(whole), axis=0)
    y = contest.predict((*effects, offer))(whole, starts)
    y0 = contest.predict(effects)(fit.x[None], fit.starts[None])
    # a trial that has left for good says nothing of small amounts
    far = 1e3 * contest.bench.model.basis.scale
    change = np.clip(np.where(np.isfinite(y), y - y0, 0.0), -far, far) * contest.data.weight
    if n:
        change /= np.tile(step, len(guesses))[:, None, None, None]
    each = max(n, 1)
    flat = change.reshape(len(guesses), each, len(fit.starts), -1).transpose(0, 2, 3, 1)
    return guesses, list(flat)


def _gain(
    fit: Fit, residual: np.ndarray, slopes: np.ndarray, begun: np.ndarray, prior: Belief,
    group: np.ndarray, offer: Instance,
) -> tuple[float, np.ndarray]:  # fmt: skip
    """Misfit taken away by the best amount of a change, and that amount."""
    k = slopes.shape[2]
    both = np.concatenate([slopes, group], axis=2)
    curvature, gradient, *_ = eliminate(residual, both, begun)
    # what a moved uncertainty costs counts too: an effect that lets it go back gains that
    gradient[:k] -= (fit.x - prior.mean) / prior.deviation**2
    n = offer.effect.amplitudes
    inverse = np.concatenate(
        [1.0 / prior.deviation**2, [1.0 / p.prior.deviation**2 for p in offer.effect.parameters[:n]] or [1.0]]
    )
    h = curvature + np.diag(inverse)
    spare = np.linalg.solve(h[:k, :k], np.concatenate([h[:k, k:], gradient[:k, None]], axis=1))
    own = h[k:, k:] - h[k:, :k] @ spare[:, :-1]
    pull = gradient[k:] - h[k:, :k] @ spare[:, -1]
    amount = np.linalg.lstsq(own, pull, rcond=1e-10)[0]
    if n == 0:
        amount = np.clip(amount, 0.0, 1.0)
    for i, p in enumerate(offer.effect.parameters[:n]):
        if isinstance(p.prior, HalfNormal):
            amount[i] = max(amount[i], 1e-3 * p.prior.deviation)
        amount[i] = np.clip(amount[i], -3.0 * p.prior.deviation, 3.0 * p.prior.deviation)
    return float(2.0 * amount @ pull - amount @ own @ amount), amount


@dataclass(frozen=True)
class Explained:
    """One hypothesis after its fit."""

    effects: tuple[Instance, ...]
    fit: Fit
    log_evidence: float = float("nan")
    """Over `none` [nat]."""
    noise: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    """Parameters of an effect that only moves single samples, each with its 90 % interval."""

    @property
    def n_own(self) -> int:
        """Number of unknowns that belong to the effects."""
        return sum(len(e.effect.parameters) for e in self.effects)

    def own(self, instance: Instance) -> slice:
        """Where the unknowns of one of the effects stand; what only moves single samples has none."""
        fitted = [e for e in self.effects if not isinstance(e.effect, Noise)]
        at = sum(len(e.effect.parameters) for e in fitted[: fitted.index(instance)])
        return slice(at, at + len(instance.effect.parameters))


def log_evidence(one: Explained, bench: Bench, temper: float) -> float:
    """Laplace's approximation of the logarithm of the evidence, with the noise widened by ``temper``.

    Source: MacKay, "Information Theory, Inference, and Learning Algorithms", 2003, ch. 28.
    """
    prior, fit = belief(one.effects, bench), one.fit
    effect_priors = [p.prior for e in one.effects for p in e.effect.parameters]
    own = sum(p.log_density(float(x)) for p, x in zip(effect_priors, fit.x, strict=False))
    spare = fit.x[one.n_own :] / prior.deviation[one.n_own :]
    spare_density = -0.5 * float(spare @ spare) - float(np.log(prior.deviation[one.n_own :]).sum())
    spare_density -= 0.5 * len(spare) * np.log(2.0 * np.pi)
    h = fit.curvature / temper + np.diag(1.0 / prior.deviation**2)
    sign, log_det = np.linalg.slogdet(h)
    if sign <= 0:
        log_det = float(np.log(np.maximum(np.linalg.eigvalsh(h), 1e-12)).sum())
    k = len(fit.x)
    return (
        -0.5 * fit.misfit / temper
        + own
        + spare_density
        + 0.5 * k * np.log(2.0 * np.pi)
        - 0.5 * log_det
        - 0.5 * fit.log_det_starts
    )


SHARES = (1.0, 0.5, 0.25, 0.1, 0.03)


def _damped(
    contest: Contest, effects: tuple[Instance, ...], base: Fit, offer: Instance, x: np.ndarray
) -> np.ndarray:
    """Unknowns to begin from: as much of the promised amplitude as the full rollouts welcome."""
    known, n = sum(len(e.effect.parameters) for e in effects), offer.effect.amplitudes
    tried = np.repeat(x[None], len(SHARES) if n else 1, axis=0)
    if n:
        tried[:, :n] *= np.array(SHARES)[:, None]
    whole = np.stack([np.concatenate([base.x[:known], row, base.x[known:]]) for row in tried])
    if not n:
        return whole[0]
    y = contest.predict((*effects, offer))(whole, np.repeat(base.starts[None], len(whole), axis=0))
    misfit = np.sum(((contest.data.y - y) * contest.data.weight) ** 2, axis=(1, 2, 3))
    return whole[int(np.argmin(np.where(np.isfinite(misfit), misfit, np.inf)))]


def pursue(
    contest: Contest, effects: tuple[Instance, ...], base: Fit, lead: Lead, *, starts: int
) -> Explained:
    """The best fit of ``effects`` and the lead's one, from the best few beginnings."""
    known = sum(len(e.effect.parameters) for e in effects)
    near = (base.slopes[..., known:], base.start_slopes)
    best: Fit | None = None
    for x in lead.starts[:starts]:
        whole = _damped(contest, effects, base, lead.instance, x)
        fit = contest.fit((*effects, lead.instance), whole, base.starts, near)
        if best is None or fit.cost < best.cost:
            best = fit
    assert best is not None
    return Explained((*effects, lead.instance), best)
