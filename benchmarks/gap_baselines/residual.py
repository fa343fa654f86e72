"""What the sim leaves unexplained of motions, and terms that might explain it, in the weak form.

Everything is an acceleration along one coordinate. Nothing is differentiated twice: the unexplained part
comes as a speed, the measured one less the integral of the sim's acceleration, and regressions use means over
stretches (Messenger and Bortz, "Weak SINDy", 2021, doi:10.1137/20M1343166). Speeds are slopes of local
cubics, whose width `prepare_dataset` sets by the noise that it estimates.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from itertools import compress

import numpy as np
from jaxtyping import Float64, Int64
from scipy.integrate import cumulative_trapezoid

from lagsplat.diagnose.data_quality.natural_period import estimate_spectral_period_s
from lagsplat.diagnose.estimation.dataset import Dataset, prepare_dataset
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.io.trajectory.trajectory import Trajectory

SLOW = 0.05
"""Share of the rms speed below which a sign is not one."""
FAR = 0.7
"""Share of the largest value beyond which an end or a limit would show."""
LEAST_HALF_SAMPLES = 3.0
"""Half the length of a stretch, in samples, at least."""
LEAST_SAMPLES = 20
"""Samples that a clip needs."""


@dataclass(frozen=True)
class Term:
    """A candidate term: the name of the effect it stands for, its values (N,), and the input it acts on."""

    name: str
    values: Float64[np.ndarray, " N"]
    input: str | None = None


@dataclass(frozen=True)
class Residual:
    """Unexplained speed (N, d) over time (N,) in clips (C, 2), and the terms of each coordinate.

    ``scale`` (d,) is the rms of the sim's own acceleration, ``period_s`` the rms period of the motion.
    """

    time_s: Float64[np.ndarray, " N"]
    clips: Int64[np.ndarray, "C 2"]
    speed: Float64[np.ndarray, "N d"]
    terms: tuple[tuple[Term, ...], ...]
    scale: Float64[np.ndarray, " d"]
    period_s: float


@dataclass(frozen=True)
class Weak:
    """Weighted means over K stretches, in the order of time: of the n terms of one coordinate (K, n), and of
    its unexplained acceleration (K,).
    """

    terms: tuple[Term, ...]
    features: Float64[np.ndarray, "K n"]
    rate: Float64[np.ndarray, " K"]


def compute_residual(model: MechanicalModel, motions: Sequence[Trajectory]) -> Residual:
    """The residual of motions under a sim.

    Raises:
        ValueError: nothing moves.
    """
    period_s = estimate_spectral_period_s(motions)
    ready = prepare_dataset(motions, period_s=period_s)
    record, q = ready.dataset, ready.dataset.smooth
    nominal = model.acceleration(q, record.v, record.u)
    speed = record.v.copy()
    for start, stop in record.clips:
        cut = slice(start, stop)
        speed[cut] -= cumulative_trapezoid(nominal[cut], record.time[cut], axis=0, initial=0.0)
    names = motions[0].u_names
    terms = tuple(tuple(_terms(model, record, q, nominal, speed, i, names)) for i in range(model.d))
    return Residual(record.time, record.clips, speed, terms, np.sqrt(np.mean(nominal**2, axis=0)), period_s)


def compute_weak_form(residual: Residual, i: int, *, periods: float) -> Weak:
    """Means of coordinate ``i`` over stretches of ``periods`` rms periods, each a quarter of that later.

    The weight is ``(1 - s^2)^4`` along a stretch, so that the mean acceleration is one of the speed. A term
    that is zero in all stretches, such as an input that moves once, has no coefficient and is left out.

    Raises:
        ValueError: no clip is long enough.
    """
    terms = residual.terms[i]
    values = np.stack([term.values for term in terms], axis=1)
    features, rates = [], []
    for start, stop in residual.clips:
        time, speed = residual.time_s[start:stop], residual.speed[start:stop, i]
        span = time[-1] - time[0]
        if stop - start < LEAST_SAMPLES:
            continue
        few = LEAST_HALF_SAMPLES * span / (stop - start)
        half = min(max(0.5 * periods * residual.period_s, few), 0.2 * span)
        step = np.gradient(time)
        for centre in np.arange(time[0] + half, time[-1] - half, 0.5 * half):
            cut = slice(*np.searchsorted(time, [centre - half, centre + half]))
            if cut.stop - cut.start < LEAST_HALF_SAMPLES:
                continue  # most of its samples were lost
            s = (time[cut] - centre) / half
            weight = (1.0 - s**2) ** 4 * step[cut]
            slope = -8.0 * s * (1.0 - s**2) ** 3 / half * step[cut]
            features.append(weight @ values[start:stop][cut] / weight.sum())
            rates.append(-slope @ speed[cut] / weight.sum())
    if not features:
        raise ValueError("no clip is long enough for a weak form; record longer")
    every = np.array(features)
    excited = np.linalg.norm(every, axis=0) > 0.0
    return Weak(tuple(compress(terms, excited)), every[:, excited], np.array(rates))


def _terms(
    model: MechanicalModel,
    record: Dataset,
    q: np.ndarray,
    nominal: np.ndarray,
    speed: np.ndarray,
    i: int,
    inputs: Sequence[str],
) -> list[Term]:
    """Every term that a static library can hold for coordinate ``i``."""
    v, s = record.v[:, i], q[:, i] - model.rest[i]
    sign = np.tanh(v / (SLOW * np.sqrt(np.mean(v**2)) + 1e-12))
    quick = np.exp(-((v / (0.3 * np.sqrt(np.mean(v**2)) + 1e-12)) ** 2))
    spring = np.linalg.solve(model.mass_at(q), model.spring(q)[..., None])[:, i, 0]
    far = FAR * np.abs(s).max()
    out = [
        Term("viscous_damping", v),
        Term("quadratic_drag", np.abs(v) * v),
        Term("coulomb_friction", sign),
        Term("stribeck_friction", sign * quick),
        Term("load_dependent_friction", sign * np.abs(spring)),
        Term("linear_stiffness", spring),
        Term("cubic_stiffness", s**3),
        Term("constant_force", np.ones_like(v)),
        Term("mass_change", nominal[:, i]),
        Term("parameter_drift", record.time * spring),
        Term("end_stop", np.maximum(s - far, 0.0)),
        Term("end_stop", np.maximum(-s - far, 0.0)),
    ]
    out += _line(record, speed[:, i])
    for j, name in enumerate(inputs):
        out += _driven(model, record, q, i, j, name)
    return [term for term in out if np.ptp(term.values) > 0.0 or term.name == "constant_force"]


def _driven(model: MechanicalModel, record: Dataset, q: np.ndarray, i: int, j: int, name: str) -> list[Term]:
    """Terms of input ``j``: its gain, its rate, what a dead zone and a limit take from it."""
    alone = np.zeros_like(record.u)
    alone[:, j] = record.u[:, j]
    u = np.linalg.solve(model.mass_at(q), model.drive(q, alone)[..., None])[:, i, 0]
    size = float(np.sqrt(np.mean(u**2)))
    if size <= 0.0:
        return []
    rate = np.concatenate([np.gradient(u[a:b], record.time[a:b]) for a, b in record.clips])
    return [
        Term("input_gain", u, name),
        Term("input_lag", rate, name),
        Term("input_dead_zone", np.tanh(u / (0.2 * size)), name),
        Term("input_saturation", np.sign(u) * np.maximum(np.abs(u) - FAR * np.abs(u).max(), 0.0), name),
    ]


def _line(record: Dataset, speed: np.ndarray) -> list[Term]:
    """The force of the strongest line in the spectrum of the longest clip's unexplained speed."""
    start, stop = max(record.clips, key=lambda clip: clip[1] - clip[0])
    time, y = record.time[start:stop], speed[start:stop]
    if stop - start < 32:
        return []
    y = y - np.polyval(np.polyfit(time, y, 1), time)
    even = np.linspace(time[0], time[-1], len(time))
    power = np.abs(np.fft.rfft(np.interp(even, time, y) * np.hanning(len(y)), 4 * len(y)))
    k = 4 + int(np.argmax(power[4:]))
    omega = 2.0 * np.pi * np.fft.rfftfreq(4 * len(y), even[1] - even[0])[k]
    wave = np.stack([np.cos(omega * time), np.sin(omega * time)], axis=1)
    a, b = np.linalg.lstsq(wave, y, rcond=None)[0]
    force = omega * (b * np.cos(omega * record.time) - a * np.sin(omega * record.time))
    return [Term("external_periodic_force", force)]
