"""One recording from one seed: mechanism, excitation, effect at the drawn gap, noise, and the truth."""

from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from benchmarks.gapgen.controllers import under_control
from benchmarks.gapgen.effect import DISCREPANCIES, NEEDS_INPUT, Effect, Setting
from benchmarks.gapgen.effects import maker
from benchmarks.gapgen.files import (
    Stratum,
    columns_of,
    interval_of,
    reels,
    sim_files,
    sims,
    without_lost_rows,
)
from benchmarks.gapgen.inputs import KINDS, SINE
from benchmarks.gapgen.mechanisms import Mechanism
from benchmarks.gapgen.motion import BURN, Clip, Plan, World, gap, reseen, seen, unseen
from benchmarks.gapgen.plans import forced_plan, free_plan, rescale_inputs, setting_of
from benchmarks.gapgen.sensors import Sensor, measured
from benchmarks.gapgen.sources import base_reach, draw_any, payload_kg, world_of

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
    """What the search for a magnitude needs; ``blocks``: how many forecasts it and the truth take at most."""

    nominal: World
    base: Mechanism
    plan: Plan
    rms: Array
    floor: float
    horizon: int
    burn: int = BURN
    sensor: Sensor = field(default_factory=Sensor)
    least: float = 1e-3
    blocks: tuple[int, int] = (14, 40)

    def clean_gap(self, effects: list[Effect]) -> float:
        """Gap of the nominal mechanism on the noise-free real motion; infinite where that escapes."""
        try:
            clips = world_of(self.base, effects).move(self.plan)
        except (FloatingPointError, ZeroDivisionError):
            return float("inf")
        ys = seen(clips, effects, self.base.d, self.plan.dt_s)
        rms = np.sqrt((np.concatenate(ys) ** 2).mean(0))
        shown = bare(clips, self.base.d)
        found = self.nominal.forecast(shown, ys, self.plan.dt_s, self.horizon, self.blocks[0], self.burn)
        return gap(found, ys, np.maximum(rms, 0.2 * self.rms), self.burn)


def bare(clips: list[Clip], d: int) -> list[Clip]:
    """The clips without internal states and with the inputs as logged."""
    return [replace(c, x=c.x[:, : 2 * d], n_sub=-1) for c in clips]


def _to_target(bench: _Bench, make: Any, target: float) -> tuple[Effect, float]:
    """The effect whose ratio is the target: gaps grow about in proportion, else bisection."""
    low, high, a = bench.least, 1.0, 0.1
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


def _tolerated(
    m: Mechanism, bench: _Bench, rng: np.random.Generator, ratio: float
) -> tuple[Mechanism, float]:
    """The mechanism whose nominal parameters are off so far that the gap is ``ratio`` times the floor."""
    seed, size = int(rng.integers(2**31)), 0.003
    wanted = np.sqrt(ratio**2 - 1.0) * bench.floor
    best = (m, 0.0)
    for _ in range(5 * (wanted > 0.0)):
        base = m.perturbed(np.random.default_rng(seed), size)
        share = max(replace(bench, base=base).clean_gap([]) / wanted, 1e-9)
        if share < 1.02 and size > best[1]:
            best = (base, size)
        if 0.9 < share < 1.02:
            break
        size = float(min(size * np.clip(0.96 / share, 0.02, 20.0), 0.05))
    return best


def _oracle(
    bench: _Bench,
    effects: list[Effect],
    further: list[Effect],
    clips: list[Clip],
    ys: list[Array],
    sigma: Array,
    rng: np.random.Generator,
) -> dict[str, float]:
    """Gaps of the sim as delivered, with the effect added, and of the true mechanism here and on average.

    What ``further`` differs in nature is in the true mechanism alone.
    """
    d, dt, n, burn, most = bench.base.d, bench.plan.dt_s, bench.horizon, bench.burn, bench.blocks[1]
    rms = np.sqrt((np.concatenate(ys) ** 2).mean(0))
    out = {"before": gap(bench.nominal.forecast(bare(clips, d), ys, dt, n, most, burn), ys, rms, burn)}
    times = [c.t0 + np.arange(len(y)) * dt for c, y in zip(clips, ys, strict=True)]

    def by(world: World, samples: list[Array]) -> float:
        inner = [unseen(y, t, effects) for y, t in zip(samples, times, strict=True)]
        found = world.forecast(clips, inner, dt, n, most, burn)
        shown = [
            (k, starts, reseen(p, np.stack([times[k][a : a + n] for a in starts]), effects))
            for k, starts, p in found
        ]
        return gap(shown, samples, rms, burn)

    truth = world_of(bench.base, effects + further)
    clean = [c.x[:, :d] for c in clips]
    clean = [reseen(q, t, effects) for q, t in zip(clean, times, strict=True)]
    out["after"] = by(truth, ys)
    out["after_sim_plus_effect"] = by(world_of(bench.nominal.mechanism, effects), ys)
    n_blocks = sum(len(y) // n + 1 for y in ys)
    draws = [
        by(truth, measured(clean, sigma, bench.sensor, rng))
        for _ in range(int(np.clip(40 // n_blocks, 2, 10)))
    ]
    out["floor"] = float(np.sqrt(np.mean(np.square(draws))))
    return out


def _plan(m: Mechanism, s: Stratum, dt: float, f1: float, rng: np.random.Generator) -> tuple[Mechanism, Plan]:
    """How the real recording is driven, and the mechanism in the units of its inputs."""
    if not s.forced:
        return m, free_plan(m, dt, s.duration_s, f1, rng)
    if s.conditions is not None and s.conditions.sine:
        kinds: tuple[str, ...] = (SINE,)
    else:
        kinds = tuple(rng.permutation(list(KINDS))) if s.duration_s > 6.0 else ("multisine", "triangle")
    plan = forced_plan(m, dt, s.duration_s, f1, rng, kinds)
    if s.controlled:
        # a target has the unit of its coordinate
        return m, plan
    m, factor = rescale_inputs(m, plan, rng)
    return m, replace(plan, inputs=[u * factor for u in plan.inputs])


def _base(s: Stratum, bench: _Bench, rng: np.random.Generator) -> tuple[Mechanism, float]:
    """The real mechanism without its effects, and how far its parameters are off the nominal ones."""
    m = bench.nominal.mechanism
    if s.conditions is not None:
        return _tolerated(m, bench, rng, s.conditions.tolerance)
    generous = rng.random() < 0.2 and s.label != ("none",)
    return _identification_error(m, bench, rng, most=1.0 if generous else 0.5)


def _burn(s: Stratum, f1: float, dt: float) -> int:
    """Samples from which a forecast starts: ten, or as many as hold a velocity at a high rate."""
    return BURN if s.conditions is None else max(BURN, round(0.15 / f1 / dt))


def draw(s: Stratum, rng: np.random.Generator, *, film_hz: float | None = None) -> Recording:
    """A recording of the stratum and its truth; to be filmed at ``film_hz`` where that is given."""
    m = draw_any(s.system, rng)
    if s.controlled:
        m = under_control(m, rng)
    f1 = float(m.frequencies_hz()[0])
    dt = interval_of(m, s, [30.0, 50.0, 100.0, 120.0], film_hz, rng)
    m, plan = _plan(m, s, dt, f1, rng)
    nominal = world_of(m)
    clips = nominal.move(plan)
    span = plan.start_s[-1] + len(plan.inputs[-1]) * dt
    setting = setting_of(m, clips, plan, forced=s.forced, span=span)
    setting = replace(setting, film=film_hz is not None, wide=s.conditions is not None)
    if "payload" in s.label:
        setting = replace(setting, payload_kg=payload_kg(m))
    if "base_motion" in s.label:
        setting = replace(setting, base_reach=base_reach(m))
    ys = [c.x[:, : m.d] for c in clips]
    burn = _burn(s, f1, dt)
    horizon = min(burn + round(1.0 / f1 / dt), max(len(y) for y in ys))
    sigma = s.noise * setting.x
    found = nominal.forecast(clips, measured(ys, sigma, s.sensor, rng), dt, horizon, 14, burn)
    floor = gap(found, measured(ys, sigma, s.sensor, rng), setting.x, burn)
    bench = _Bench(nominal, m, plan, setting.x, floor, horizon, burn, s.sensor)
    if s.conditions is not None:
        # a push is felt in the forecasts over it alone
        whole = "external_push" in s.label
        bench = replace(bench, least=1e-5, blocks=(400, 400) if whole else bench.blocks)
    base, size = _base(s, bench, rng)
    bench = replace(bench, base=base)
    effects, targets, further, clips = _effects(s, bench, setting, rng)
    clean = seen(clips, effects, m.d, dt)
    rms = np.sqrt((np.concatenate(clean) ** 2).mean(0))
    sigma = s.noise * rms
    samples = measured(clean, sigma, s.sensor, rng)
    gaps = _oracle(bench, effects, further, clips, samples, sigma, rng)
    offset = None
    if s.system == "soft_robot" and s.forced:
        offset = np.full(m.n_u, 1.1 * max(np.abs(u).max() for u in plan.inputs))
    nominal_runs = sims(m, s, f1, film_hz, rng)
    files, sim_noise = sim_files(m, s, nominal_runs, sigma, offset, rng)
    real = columns_of(clips, samples, dt, inputs=s.forced, offset=offset)
    files["real_0.csv"] = without_lost_rows(real, s.sensor, rng)
    truth = {
        "targets": targets,
        "base_error": size,
        "sim_noise": sim_noise,
        "gap": gaps,
        "horizon_s": (horizon - 1) * dt,
        "natural_hz": m.frequencies_hz().tolist(),
        "rate_hz": 1.0 / dt,
        "rms": rms.tolist(),
        **_scales(m, setting),
        "found": effects,
        "further": [{"kind": effect.name, "coordinate": effect.coordinate} for effect in further],
    }
    if s.controlled:
        truth["position_targets"] = _targets(m)
    blurred = any(e.camera and e.camera[0] == "blur" for e in effects)
    shown = [c.x[:, : m.d] for c in clips] if blurred else clean
    return Recording(files, truth, reels(nominal_runs, clips, shown, s, offset), m)


def _targets(m: Mechanism) -> dict[str, str]:
    """Inputs that are position targets, each with its coordinate."""
    return {f"u{j}": f"q{int(np.argmax(np.abs(column)))}" for j, column in enumerate(m.b.T)}


def _scales(m: Mechanism, setting: Setting) -> dict[str, Any]:
    """What the truth tells of the nominal mechanism and its motion."""
    return {
        "v_rms": setting.v.tolist(),
        "top": setting.top.tolist(),
        "u_rms": setting.u.tolist() if setting.forced else [],
        "inertia_at_rest": np.diag(m.inertia_at_rest()).tolist(),
        "span_s": setting.span_s,
    }


def _target(s: Stratum, k: int, rng: np.random.Generator) -> float:
    """The gap over the floor that the k-th effect is sized to."""
    if s.conditions is not None:
        return s.conditions.ratios[k]
    low, high = BINS[s.bin]
    return float(np.exp(rng.uniform(np.log(low * 1.05), np.log(high * 0.95))))


def _effects(
    s: Stratum, bench: _Bench, setting: Setting, rng: np.random.Generator
) -> tuple[list[Effect], list[float], list[Effect], list[Clip]]:
    """The effects of a stratum at their magnitudes, the ratios reached, what further differs, the motion."""
    effects: list[Effect] = []
    ratios: list[float] = []
    for k, name in enumerate(s.label):
        if name == "none":
            continue
        if name in NEEDS_INPUT and not s.forced:
            raise ValueError(f"{name} needs inputs; the stratum is free")
        effect, ratio = _sized(s, bench, setting, rng, name, _target(s, k, rng))
        effects.append(effect)
        ratios.append(ratio)
    further: list[Effect] = []
    if s.conditions is not None and s.conditions.discrepancy > 1.0:
        name = str(rng.choice(DISCREPANCIES))
        further = [_sized(s, bench, setting, rng, name, s.conditions.discrepancy)[0]]
    for _ in range(6):
        try:
            clips = world_of(bench.base, effects + further).move(bench.plan)
            return effects, ratios, further, clips
        except FloatingPointError:
            further, effects = [], effects if further else effects[:-1]
            ratios = ratios[: len(effects)]
    raise FloatingPointError("the mechanism escapes even without an effect")


def _sized(
    s: Stratum, bench: _Bench, setting: Setting, rng: np.random.Generator, name: str, target: float
) -> tuple[Effect, float]:
    """The named effect at a place of its own, sized to a gap over the floor, and the gap that it reached."""
    for _ in range(1 if s.conditions is None else 6):
        i, j = int(rng.integers(bench.base.d)), int(rng.integers(bench.base.n_u))
        make = maker(name, setting, i, j, rng)
        if setting.film and name in ("camera_change", "camera_drift"):
            # coordinates have no gap that a picture's displacement could be sized by
            return make(min(target / 20.0, 1.0)), target
        effect, ratio = _to_target(bench, make, target)
        # a push between two clips, or a stop at a turn that hardly comes, misses its gap
        if abs(np.log(ratio / target)) < 0.25:
            break
    return effect, ratio
