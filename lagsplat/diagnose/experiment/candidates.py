"""Experiments that a mechanism can be put to, within the inputs and the motion that its recordings show."""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.optimize import root
from scipy.signal import chirp, sawtooth

from lagsplat.diagnose.core.config import EXPERIMENT
from lagsplat.diagnose.estimation.dataset import Dataset
from lagsplat.diagnose.mechanics.model import MechanicalModel

Shape = Callable[[np.ndarray, float, np.random.Generator, tuple[float, float]], np.ndarray]
"""An input between -1 and 1 at times (N,) [s], for a natural frequency [Hz] and a band in units of it."""


@dataclass(frozen=True)
class Experiment:
    """Inputs from a start at rest, and a payload that is known.

    ``what`` says in words what is done, ``payload`` is the inertia that it adds, as a share of that at rest.
    """

    kind: str
    what: str
    time_s: Float64[np.ndarray, " N"]
    u: Float64[np.ndarray, "N n_u"]
    start: Float64[np.ndarray, " d"]
    payload: float = 0.0

    @property
    def duration_s(self) -> float:
        """Length [s]."""
        return float(self.time_s[-1])


@dataclass(frozen=True)
class RecordedRange:
    """Inputs and coordinates that recordings show: their middles, half ranges, and the inputs' rates."""

    u_middle: Float64[np.ndarray, " n_u"]
    u_reach: Float64[np.ndarray, " n_u"]
    u_rate: Float64[np.ndarray, " n_u"]  # fastest change of each input [its unit per s]
    q_middle: Float64[np.ndarray, " d"]
    q_reach: Float64[np.ndarray, " d"]

    @classmethod
    def of(cls, record: Dataset) -> "RecordedRange":
        """The range of a dataset."""
        rates = [
            np.abs(np.diff(record.u[a:b], axis=0)) / np.diff(record.time[a:b])[:, None]
            for a, b in record.clips
        ]
        fastest = np.quantile(np.concatenate(rates), EXPERIMENT.rate_quantile, axis=0)
        (u_low, u_high), (q_low, q_high) = ((x.min(axis=0), x.max(axis=0)) for x in (record.u, record.q))
        u_middle, u_reach = 0.5 * (u_low + u_high), 0.5 * (u_high - u_low)
        return cls(u_middle, u_reach, fastest, 0.5 * (q_low + q_high), 0.5 * (q_high - q_low))

    @property
    def driven(self) -> list[int]:
        """Inputs that move."""
        return np.flatnonzero(self.u_reach > 1e-9 * np.maximum(np.abs(self.u_middle), 1e-9)).tolist()

    def holds(self, q: Float64[np.ndarray, "N d"]) -> bool:
        """Whether a motion stays within `EXPERIMENT.reach` of the range."""
        away = np.abs(q - self.q_middle)
        return bool(np.isfinite(q).all() and (away <= EXPERIMENT.reach * self.q_reach).all())


def _multisine(t: np.ndarray, f: float, rng: np.random.Generator, band: tuple[float, float]) -> np.ndarray:
    hertz = f * np.geomspace(*band, EXPERIMENT.lines)
    phase = rng.uniform(0.0, 2.0 * np.pi, len(hertz))
    wave = np.sin(2.0 * np.pi * hertz * t[:, None] + phase).sum(axis=1)
    return np.minimum(t * f, 1.0) * wave / np.abs(wave).max()  # it swells from zero in one natural period


def _switching(t: np.ndarray, f: float, rng: np.random.Generator, band: tuple[float, float]) -> np.ndarray:
    return np.sign(_multisine(t, f, rng, band))


def _steps(t: np.ndarray, f: float, rng: np.random.Generator, band: tuple[float, float]) -> np.ndarray:
    levels = np.concatenate([[0.0], rng.permutation([1.0, -1.0, 0.5, -0.5]), [0.0]])
    return levels[np.minimum((t / t[-1] * len(levels)).astype(int), len(levels) - 1)]


def _hold(t: np.ndarray, f: float, rng: np.random.Generator, band: tuple[float, float]) -> np.ndarray:
    share = t / t[-1]
    return ((share > 0.1) & (share < 0.7)).astype(np.float64)


def _triangle(t: np.ndarray, f: float, rng: np.random.Generator, band: tuple[float, float]) -> np.ndarray:
    return np.asarray(sawtooth(2.0 * np.pi * band[0] * f * t + 0.5 * np.pi, 0.5), dtype=np.float64)


def _chirp(t: np.ndarray, f: float, rng: np.random.Generator, band: tuple[float, float]) -> np.ndarray:
    low, high = (f * share for share in band)
    return np.asarray(chirp(t, low, float(t[-1]), high, method="logarithmic", phi=-90.0), dtype=np.float64)


SHAPES: tuple[tuple[str, str, float, Shape, tuple[float, float]], ...] = (
    ("multisine", "a multisine", 1.0, _multisine, (0.1, 2.5)),
    ("multisine", "a slow multisine", 1.0, _multisine, (0.1, 0.8)),
    ("multisine", "a fast multisine", 1.0, _multisine, (1.0, 4.0)),
    ("switching", "an input switched to and fro", 1.0, _switching, (0.2, 2.5)),
    ("steps", "steps", 1.0, _steps, (0.0, 0.0)),
    ("chirp", "a chirp", 1.0, _chirp, (0.1, 2.5)),
    ("triangle", "a slow triangle", 1.6, _triangle, (0.125, 0.0)),
    ("hold", "one long hold", 1.6, _hold, (0.0, 0.0)),
)
"""Kind, words, length in `EXPERIMENT.periods`, shape, and band [natural frequencies] of ways to drive."""


def propose_experiments(
    model: MechanicalModel, record: Dataset, *, period_s: float, channels: Sequence[int] = ()
) -> Iterator[Iterator[Experiment]]:
    """Experiments within the recorded inputs: for each its versions at falling levels, the largest first.

    All inputs are driven together, and each of ``channels`` alone; the mechanism is also released from
    visited poses, as it is and with a payload. Motions may still leave the visited range.
    """
    span = RecordedRange.of(record)
    rest = find_equilibrium(model, span, span.u_middle)
    alone = [[c] for c in dict.fromkeys(channels) if c in span.driven and len(span.driven) > 1]
    for kind, what, length, shape, band in SHAPES:
        time_s = _sample(length * EXPERIMENT.periods * period_s, record.dt_s)
        for driven in [span.driven, *alone] if span.driven else ():
            for seed in range(EXPERIMENT.seeds if shape in (_multisine, _switching, _steps) else 1):
                rng = np.random.default_rng(seed)
                unit = np.zeros((len(time_s), record.u.shape[1]))
                for c in driven:
                    unit[:, c] = span.u_reach[c] * shape(time_s, 1.0 / period_s, rng, band)
                most = span.u_rate * record.dt_s
                yield (
                    Experiment(kind, what, time_s, span.u_middle + limit_rate(level * unit, most), rest)
                    for level in EXPERIMENT.levels
                )
    time_s = _sample(EXPERIMENT.periods * period_s, record.dt_s)
    held = np.repeat(span.u_middle[None], len(time_s), axis=0)
    for pose in _visited_poses(record, rest):
        for kind, what, payload in (
            ("release", "a release from rest", 0.0),
            ("known_payload", "a release from rest with a known payload", EXPERIMENT.payload),
        ):
            yield (
                Experiment(kind, what, time_s, held, rest + level * (pose - rest), payload)
                for level in EXPERIMENT.levels
            )


def _sample(length_s: float, dt_s: float) -> np.ndarray:
    return np.arange(max(round(length_s / dt_s), EXPERIMENT.min_samples) + 1) * dt_s


def _visited_poses(record: Dataset, rest: np.ndarray) -> list[np.ndarray]:
    """The frames in which each coordinate is farthest from rest, to either side."""
    away = record.q - rest
    frames = [int(find(away[:, i])) for i in range(record.d) for find in (np.argmin, np.argmax)]
    return [record.q[frame] for frame in dict.fromkeys(frames)]


def find_equilibrium(
    model: MechanicalModel, span: RecordedRange, u: Float64[np.ndarray, " n_u"]
) -> Float64[np.ndarray, " d"]:
    """Where the model rests under held inputs; its rest without inputs where there is none in the range."""
    found = root(lambda q: (model.spring(q[None]) + model.drive(q[None], u[None]))[0], model.rest)
    return found.x if found.success and span.holds(found.x[None]) else model.rest


def limit_rate(u: Float64[np.ndarray, "N n_u"], most: Float64[np.ndarray, " n_u"]) -> np.ndarray:
    """Follow inputs that start at zero by at most ``most`` between two samples, (N, n_u)."""
    out = np.zeros(u.shape)
    for i in range(1, len(out)):
        out[i] = out[i - 1] + np.clip(u[i] - out[i - 1], -most, most)
    return out
