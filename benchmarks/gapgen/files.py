"""What is handed out of a recording: nominal and real columns, and the coordinates of its films."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.gapgen.mechanisms import Mechanism
from benchmarks.gapgen.motion import Clip
from benchmarks.gapgen.plans import forced_plan, free_plan
from benchmarks.gapgen.sensors import QUANTISED, Conditions, Sensor, kept_rows, measured
from benchmarks.gapgen.sources import world_of

MOST_SAMPLES = 12_000
LEAST_SAMPLES_A_PERIOD = 12.0

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Stratum:
    """What is laid down for a recording before anything is drawn, wide conditions included."""

    label: tuple[str, ...]
    system: str
    forced: bool
    noise: float
    duration_s: float
    bin: str
    conditions: Conditions | None = None

    @property
    def controlled(self) -> bool:
        """Whether the inputs are position targets."""
        return self.conditions is not None and self.conditions.controlled

    @property
    def sensor(self) -> Sensor:
        """How the coordinates are measured."""
        return Sensor() if self.conditions is None else self.conditions.sensor


def columns_of(
    clips: list[Clip], ys: list[Array], dt: float, *, inputs: bool, offset: Array | None
) -> dict[str, Array]:
    """Columns ``t``, ``q*``, ``u*`` where there are inputs, and ``segment`` where there are several clips."""
    t = np.concatenate([c.t0 + np.arange(len(y)) * dt for c, y in zip(clips, ys, strict=True)])
    columns = {"t": t}
    y = np.concatenate(ys)
    columns |= {f"q{i}": y[:, i] for i in range(y.shape[1])}
    if inputs:
        u = np.concatenate([c.u for c in clips]) + (0.0 if offset is None else offset)
        columns |= {f"u{j}": u[:, j] for j in range(u.shape[1])}
    if len(clips) > 1:
        columns["segment"] = np.concatenate([np.full(len(y), k) for k, y in enumerate(ys)])
    return columns


def least_rate_hz(m: Mechanism) -> float:
    """The lowest rate [Hz] that resolves the fastest natural motion."""
    return LEAST_SAMPLES_A_PERIOD * float(m.frequencies_hz()[-1])


def interval_of(
    m: Mechanism, s: Stratum, others: list[float], film_hz: float | None, rng: np.random.Generator
) -> float:
    """Seconds between samples: a sixtieth, at times of one of ``others`` [Hz], or the stratum's."""
    if s.conditions is None:
        rate = 60.0 if rng.random() < 0.8 else float(rng.choice(others))
    else:
        rate = max(s.conditions.rate_hz, least_rate_hz(m))
    return 1.0 / (rate if film_hz is None else film_hz)


def reference_interval(m: Mechanism, s: Stratum, film_hz: float | None, rng: np.random.Generator) -> float:
    """Seconds between the samples of a nominal recording."""
    if s.conditions is not None and rng.random() < 0.3:
        return float(np.exp(-rng.uniform(np.log(least_rate_hz(m)), np.log(1000.0))))
    return interval_of(m, s, [50.0, 100.0, 120.0], film_hz, rng)


def sims(m: Mechanism, s: Stratum, f1: float, rate: float | None, rng: np.random.Generator) -> list[Any]:
    """(clips, sample interval) of one to three nominal recordings under excitations of their own."""
    out = []
    n_files = int(rng.integers(1, 4)) if s.forced else int(rng.integers(1, 3))
    for k in range(n_files):
        dt = reference_interval(m, s, rate, rng)
        span = float(rng.uniform(14.0, 30.0)) if n_files < 3 else float(rng.uniform(9.0, 16.0))
        span = span if s.conditions is None else min(span, MOST_SAMPLES * dt)
        if s.forced and (k == 0 or rng.random() < 0.7):
            kinds = tuple(rng.permutation(["multisine", "chirp", "steps"])[: int(rng.integers(2, 4))])
            plan = forced_plan(m, dt, span, f1, rng, kinds)
        else:
            plan = free_plan(m, dt, span, f1, rng)
        out.append((world_of(m).move(plan), dt))
    return out


def sim_files(
    m: Mechanism, s: Stratum, sims: list[Any], sigma: Array, offset: Array | None, rng: np.random.Generator
) -> tuple[dict[str, dict[str, Array]], float]:
    """Columns of the nominal recordings and their noise: the real one's, ``sigma`` (d,), or none."""
    noise = s.noise if rng.random() < 0.7 or s.conditions is not None else 0.0
    with_v = rng.random() < 0.3
    files = {}
    for k, (clips, dt) in enumerate(sims):
        qs = [c.x[:, : m.d] for c in clips]
        rms = np.sqrt((np.concatenate(qs) ** 2).mean(0))
        # an encoder counts alike in every recording
        error = sigma if s.sensor.kind == QUANTISED else noise * rms
        columns = columns_of(clips, measured(qs, error, s.sensor, rng), dt, inputs=s.forced, offset=offset)
        if with_v:
            v = np.concatenate([c.x[:, m.d : 2 * m.d] for c in clips])
            (v,) = measured([v], noise * np.sqrt((v**2).mean(0)), s.sensor, rng)
            columns |= {f"v{i}": v[:, i] for i in range(m.d)}
        files[f"sim_{k}.csv"] = without_lost_rows(columns, s.sensor, rng)
    return files, noise


def without_lost_rows(
    columns: dict[str, Array], sensor: Sensor, rng: np.random.Generator
) -> dict[str, Array]:
    """The columns without the rows that a sensor loses."""
    if sensor.lost <= 0.0:
        return columns
    keep = kept_rows(len(columns["t"]), sensor, rng)
    return {name: column[keep] for name, column in columns.items()}


def reels(
    sims: list[Any], clips: list[Clip], clean: list[Array], s: Stratum, offset: Array | None
) -> list[Any]:
    """What is filmed: every nominal clip and every real one apart."""
    nominal = [c for group, _ in sims for c in group]
    d = clean[0].shape[1]
    shown = [("sim", c.t0, c.x[:, :d], c.u, False) for c in nominal]
    shown += [("real", c.t0, q, c.u, True) for c, q in zip(clips, clean, strict=True)]
    count = {"sim": 0, "real": 0}
    out = []
    for stem, t0, q, u, real in shown:
        lifted = u + (0.0 if offset is None else offset) if s.forced else None
        out.append((f"{stem}_{count[stem]}", t0, q, lifted, real))
        count[stem] += 1
    return out
