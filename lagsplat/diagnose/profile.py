"""How likely the data are along one parameter of an effect, everything else fitted anew."""

from collections.abc import Iterator
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.compare import Contest, Explained, belief
from lagsplat.diagnose.effects.effect import Noise
from lagsplat.diagnose.reported import told, unit
from lagsplat.diagnose.shoot import penalty, shoot

POINTS = 4
"""To each side of the best value."""
FAR = 3.5
"""Standard deviations that they reach out."""
STEPS = 4
MOST = 4
"""Parameters that are profiled."""
HELD = 1e-4
"""Standard deviations within which the parameter is held."""


@dataclass(frozen=True)
class Profile:
    """Nats below the best fit at ``values`` of a parameter, in its ``unit``."""

    effect: str
    parameter: str
    unit: str
    values: Float64[np.ndarray, " n"]
    log_likelihood: Float64[np.ndarray, " n"]


def profiles(contest: Contest, one: Explained, *, temper: float) -> Iterator[Profile]:
    """Profiles of the first parameters of the effects that are told by one number each.

    Source: profile likelihood, Raue et al., 2009, doi:10.1093/bioinformatics/btp358.
    """
    effects = tuple(e for e in one.effects if not isinstance(e.effect, Noise))
    if not np.isfinite(one.fit.curvature).all():
        return
    curvature = one.fit.curvature / temper + np.diag(1.0 / belief(effects, contest.bench).deviation ** 2)
    spread = np.sqrt(np.maximum(np.diag(np.linalg.pinv(curvature)), 0.0))
    count = 0
    for instance in effects:
        own = one.own(instance)
        keys = told(instance, instance.physical(one.fit.x[None, own])[0], contest.bench.record)
        for i, parameter in enumerate(instance.effect.parameters):
            if parameter.name not in keys or count == MOST:
                continue
            count += 1
            at = own.start + i
            x, fall = _walk(contest, replace(one, effects=effects), at, spread[at], temper)
            rows = np.repeat(one.fit.x[None, own], len(x), axis=0)
            rows[:, i] = x
            physical = instance.physical(rows)
            values = [told(instance, row, contest.bench.record)[parameter.name] for row in physical]
            where = unit(instance, parameter.name)
            yield Profile(instance.effect.name, parameter.name, where, np.array(values), fall)


def _walk(
    contest: Contest, one: Explained, at: int, spread: float, temper: float
) -> tuple[np.ndarray, np.ndarray]:
    """Unknowns to both sides of the best, and the nats that the best fit beside each loses."""
    best, held = one.fit.x[at], contest.belief(one.effects)
    near = (one.fit.slopes[..., one.n_own :], one.fit.start_slopes)
    rows = [(best, 0.0)]
    for side in (-1.0, 1.0):
        x, starts = one.fit.x, one.fit.starts
        for k in range(1, POINTS + 1):
            value = max(best + side * FAR * spread * k / POINTS, held.lowest[at])
            if value == x[at]:
                break
            mean, deviation = held.mean.copy(), held.deviation.copy()
            mean[at], deviation[at] = value, HELD * spread
            pinned = replace(held, mean=mean, deviation=deviation)
            moved = x.copy()
            moved[at] = value
            fit = shoot(
                contest.predict(one.effects), moved, starts, contest.data, pinned,
                iterations=STEPS, tolerance=contest.tolerance, known=near,
            )  # fmt: skip
            x, starts = fit.x, fit.starts
            paid = float(penalty(fit.x[None], held)[0])
            priced = 0.5 * (paid - one.fit.penalty) / contest.price
            lost = 0.5 * (fit.misfit - one.fit.misfit) / temper + priced
            rows.append((float(value), -lost))
    rows.sort()
    values, fall = np.array(rows).T
    return values, fall
