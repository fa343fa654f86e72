"""What is handed out of a recording: nominal and real columns, and the coordinates of its films."""

from dataclasses import dataclass
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.gapgen.mechanisms import Mechanism
from benchmarks.gapgen.motion import Clip, World
from benchmarks.gapgen.plans import forced_plan, free_plan

Array = NDArray[np.float64]


@dataclass(frozen=True)
class Stratum:
    """What is laid down for a recording before anything is drawn."""

    label: tuple[str, ...]
    system: str
    forced: bool
    noise: float
    duration_s: float
    bin: str


def noisy(ys: list[Array], sigma: Array, rng: np.random.Generator) -> list[Array]:
    """Samples with independent Gaussian noise of deviation ``sigma`` (d,)."""
    return [y + sigma * rng.standard_normal(y.shape) for y in ys]


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


def sims(m: Mechanism, s: Stratum, f1: float, rate: float | None, rng: np.random.Generator) -> list[Any]:
    """(clips, sample interval) of one to three nominal recordings under excitations of their own."""
    out = []
    n_files = int(rng.integers(1, 4)) if s.forced else int(rng.integers(1, 3))
    for k in range(n_files):
        dt = 1.0 / 60.0 if rng.random() < 0.8 else 1.0 / float(rng.choice([50.0, 100.0, 120.0]))
        dt = dt if rate is None else 1.0 / rate
        span = float(rng.uniform(14.0, 30.0)) if n_files < 3 else float(rng.uniform(9.0, 16.0))
        if s.forced and (k == 0 or rng.random() < 0.7):
            kinds = tuple(rng.permutation(["multisine", "chirp", "steps"])[: int(rng.integers(2, 4))])
            plan = forced_plan(m, dt, span, f1, rng, kinds)
        else:
            plan = free_plan(m, dt, span, f1, rng)
        out.append((World(m).move(plan), dt))
    return out


def sim_files(
    m: Mechanism, s: Stratum, sims: list[Any], offset: Array | None, rng: np.random.Generator
) -> tuple[dict[str, dict[str, Array]], float]:
    """Columns of the nominal recordings and their noise: the real one's or none."""
    noise = s.noise if rng.random() < 0.7 else 0.0
    with_v = rng.random() < 0.3
    files = {}
    for k, (clips, dt) in enumerate(sims):
        qs = [c.x[:, : m.d] for c in clips]
        rms = np.sqrt((np.concatenate(qs) ** 2).mean(0))
        columns = columns_of(clips, noisy(qs, noise * rms, rng), dt, inputs=s.forced, offset=offset)
        if with_v:
            v = np.concatenate([c.x[:, m.d : 2 * m.d] for c in clips])
            v = v + noise * np.sqrt((v**2).mean(0)) * rng.standard_normal(v.shape)
            columns |= {f"v{i}": v[:, i] for i in range(m.d)}
        files[f"sim_{k}.csv"] = columns
    return files, noise


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
