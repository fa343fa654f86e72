"""One recording from one seed: mechanism, excitation, effect at the drawn gap, noise, and the truth."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.gapgen.effect import NEEDS_INPUT, Effect, Setting
from benchmarks.gapgen.effects import maker
from benchmarks.gapgen.files import Stratum, columns_of, noisy, reels, sim_files, sims
from benchmarks.gapgen.inputs import KINDS
from benchmarks.gapgen.mechanisms import Mechanism, draw_mechanism
from benchmarks.gapgen.motion import BURN, Clip, Plan, World, gap, reseen, seen, unseen
from benchmarks.gapgen.plans import forced_plan, free_plan, rescale_inputs, setting_of

Array = NDArray[np.float64]
BINS = {"low": (1.5, 3.0), "middle": (3.0, 10.0), "high": (10.0, 40.0)}


@dataclass
class Recording:
    """One recording: columns of its files by name, the truth, and what a film of it needs.

    ``reels`` (stem, start [s], coordinates (T, d), inputs (T, n_u) or None, whether real) are in order.
    """

    files: dict[str, dict[str, Array]]
    truth: dict[str, Any]
    reels: list[tuple[str, float, Array, Array | None, bool]] = field(default_factory=list)
    nominal: Mechanism | None = None


@dataclass
class _Bench:
    """What the search for a magnitude needs."""

    nominal: World
    base: Mechanism
    plan: Plan
    rms: Array
    floor: float
    horizon: int

    def clean_gap(self, effects: list[Effect]) -> float:
        """Gap of the nominal mechanism on the noise-free real motion; infinite where that escapes."""
        try:
            clips = World(self.base, effects).move(self.plan)
        except FloatingPointError:
            return float("inf")
        ys = seen(clips, effects, self.base.d, self.plan.dt_s)
        rms = np.sqrt((np.concatenate(ys) ** 2).mean(0))
        found = self.nominal.forecast(bare(clips, self.base.d), ys, self.plan.dt_s, self.horizon, 14)
        return gap(found, ys, np.maximum(rms, 0.2 * self.rms))


def bare(clips: list[Clip], d: int) -> list[Clip]:
    """The clips without internal states and with the inputs as logged."""
    return [replace(c, x=c.x[:, : 2 * d], n_sub=-1) for c in clips]


def _to_target(bench: _Bench, make: Any, target: float) -> tuple[Effect, float]:
    """The effect whose ratio is the target: gaps grow about in proportion, else bisection."""
    low, high, a = 1e-3, 1.0, 0.1
    wanted = np.sqrt(target**2 - 1.0) * bench.floor
    best, best_ratio = make(a), float("nan")
    for _ in range(9):
        effect = make(a)
        found = bench.clean_gap([effect])
        ratio = float(np.hypot(found, bench.floor) / bench.floor)
        if np.isfinite(ratio) and not abs(np.log(ratio / target)) > abs(np.log(best_ratio / target)):
            best, best_ratio = effect, ratio
        if abs(np.log(ratio / target)) < 0.08 or low > 0.97 * high:
            break
        low, high = (low, a) if ratio > target else (a, high)
        a = a * wanted / found if np.isfinite(found) and found > 0.0 else np.sqrt(low * high)
        if not low < a < high:
            a = float(np.sqrt(low * high))
    return best, best_ratio


def _identification_error(
    m: Mechanism, bench: _Bench, rng: np.random.Generator, *, most: float
) -> tuple[Mechanism, float]:
    size = 0.01 * rng.beta(1.2, 2.5)
    seed = int(rng.integers(2**31))
    for _ in range(6):
        base = m.perturbed(np.random.default_rng(seed), size)
        there = replace(bench, base=base)
        excess = there.clean_gap([]) / (most * bench.floor)
        if excess <= 1.0:
            break
        size /= 1.1 * excess
    return base, size


def _oracle(
    bench: _Bench,
    effects: list[Effect],
    clips: list[Clip],
    ys: list[Array],
    sigma: Array,
    rng: np.random.Generator,
) -> dict[str, float]:
    """Gaps of the sim as delivered, with the effect added, and of the true mechanism here and on average."""
    d, dt, n = bench.base.d, bench.plan.dt_s, bench.horizon
    rms = np.sqrt((np.concatenate(ys) ** 2).mean(0))
    out = {"before": gap(bench.nominal.forecast(bare(clips, d), ys, dt, n, 40), ys, rms)}
    times = [c.t0 + np.arange(len(y)) * dt for c, y in zip(clips, ys, strict=True)]

    def by(world: World, samples: list[Array]) -> float:
        inner = [unseen(y, t, effects) for y, t in zip(samples, times, strict=True)]
        found = world.forecast(clips, inner, dt, n, 40)
        shown = [
            (k, starts, reseen(p, np.stack([times[k][a : a + n] for a in starts]), effects))
            for k, starts, p in found
        ]
        return gap(shown, samples, rms)

    truth = World(bench.base, effects)
    clean = [c.x[:, :d] for c in clips]
    clean = [reseen(q, t, effects) for q, t in zip(clean, times, strict=True)]
    out["after"] = by(truth, ys)
    out["after_sim_plus_effect"] = by(World(bench.nominal.mechanism, effects), ys)
    n_blocks = sum(len(y) // n + 1 for y in ys)
    draws = [by(truth, noisy(clean, sigma, rng)) for _ in range(int(np.clip(40 // n_blocks, 2, 10)))]
    out["floor"] = float(np.sqrt(np.mean(np.square(draws))))
    return out


def draw(s: Stratum, rng: np.random.Generator, *, film_hz: float | None = None) -> Recording:
    """A recording of the stratum and its truth; to be filmed at ``film_hz`` where that is given."""
    m = draw_mechanism(s.system, rng)
    f1 = float(m.frequencies_hz()[0])
    dt = 1.0 / (60.0 if rng.random() < 0.8 else float(rng.choice([30.0, 50.0, 100.0, 120.0])))
    dt = dt if film_hz is None else 1.0 / film_hz
    if s.forced:
        kinds = tuple(rng.permutation(list(KINDS))) if s.duration_s > 6.0 else ("multisine", "triangle")
        plan = forced_plan(m, dt, s.duration_s, f1, rng, kinds)
        m, factor = rescale_inputs(m, plan, rng)
        plan = replace(plan, inputs=[u * factor for u in plan.inputs])
    else:
        plan = free_plan(m, dt, s.duration_s, f1, rng)
    nominal = World(m)
    clips = nominal.move(plan)
    span = plan.start_s[-1] + len(plan.inputs[-1]) * dt
    setting = setting_of(m, clips, plan, forced=s.forced, span=span)
    setting = replace(setting, film=film_hz is not None)
    ys = [c.x[:, : m.d] for c in clips]
    shortest = max(len(y) for y in ys)
    horizon = min(BURN + round(1.0 / f1 / dt), shortest)
    found = nominal.forecast(clips, noisy(ys, s.noise * setting.x, rng), dt, horizon, 14)
    floor = gap(found, noisy(ys, s.noise * setting.x, rng), setting.x)
    bench = _Bench(nominal, m, plan, setting.x, floor, horizon)
    generous = rng.random() < 0.2 and s.label != ("none",)
    base, size = _identification_error(m, bench, rng, most=1.0 if generous else 0.5)
    bench = replace(bench, base=base)
    effects, targets, clips = _effects(s, bench, setting, rng)
    clean = seen(clips, effects, m.d, dt)
    sigma = s.noise * np.sqrt((np.concatenate(clean) ** 2).mean(0))
    samples = noisy(clean, sigma, rng)
    gaps = _oracle(bench, effects, clips, samples, sigma, rng)
    offset = None
    if s.system == "soft_robot" and s.forced:
        offset = np.full(m.n_u, 1.1 * max(np.abs(u).max() for u in plan.inputs))
    nominal_runs = sims(m, s, f1, film_hz, rng)
    files, sim_noise = sim_files(m, s, nominal_runs, offset, rng)
    files["real_0.csv"] = columns_of(clips, samples, dt, inputs=s.forced, offset=offset)
    truth = {
        "targets": targets,
        "base_error": size,
        "sim_noise": sim_noise,
        "gap": gaps,
        "horizon_s": (horizon - 1) * dt,
        "natural_hz": m.frequencies_hz().tolist(),
        "rate_hz": 1.0 / dt,
        "rms": np.sqrt((np.concatenate(clean) ** 2).mean(0)).tolist(),
        "v_rms": setting.v.tolist(),
        "top": setting.top.tolist(),
        "u_rms": setting.u.tolist() if s.forced else [],
        "inertia_at_rest": np.diag(m.inertia_at_rest()).tolist(),
        "span_s": span,
    }
    blurred = any(e.camera and e.camera[0] == "blur" for e in effects)
    shown = [c.x[:, : m.d] for c in clips] if blurred else clean
    return Recording(files, truth | {"found": effects}, reels(nominal_runs, clips, shown, s, offset), m)


def _effects(
    s: Stratum, bench: _Bench, setting: Setting, rng: np.random.Generator
) -> tuple[list[Effect], list[float], list[Clip]]:
    """The effects of a stratum at their magnitudes, the ratios reached, and the true motion."""
    effects: list[Effect] = []
    ratios: list[float] = []
    m = bench.base
    for name in s.label:
        if name == "none":
            continue
        if name in NEEDS_INPUT and not s.forced:
            raise ValueError(f"{name} needs inputs; the stratum is free")
        low, high = BINS[s.bin]
        target = float(np.exp(rng.uniform(np.log(low * 1.05), np.log(high * 0.95))))
        i, j = int(rng.integers(m.d)), int(rng.integers(m.n_u))
        make = maker(name, setting, i, j, rng)
        if setting.film and name in ("camera_change", "camera_drift"):
            # coordinates have no gap that a picture's displacement could be sized by
            effect, ratio = make(min(target / 20.0, 1.0)), target
        else:
            effect, ratio = _to_target(bench, make, target)
        effects.append(effect)
        ratios.append(ratio)
    for _ in range(6):
        try:
            return effects, ratios, World(m, effects).move(bench.plan)
        except FloatingPointError:
            effects = effects[:-1] if len(effects) > 1 else []
            ratios = ratios[: len(effects)]
    raise FloatingPointError("the mechanism escapes even without an effect")
