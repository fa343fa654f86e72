"""Every effect at every place where it may act on the mechanism at hand."""

from collections.abc import Sequence
from dataclasses import replace
from importlib import import_module
from pkgutil import iter_modules

import numpy as np
from jaxtyping import Float64
from scipy.signal import find_peaks

from lagsplat.diagnose import effects
from lagsplat.diagnose.effects.effect import (
    Direction,
    Effect,
    Force,
    InputChange,
    Instance,
    Scales,
)
from lagsplat.diagnose.simulate import Bench

EVENTS = 4
LINES = 5


def catalogue() -> dict[str, Effect]:
    """All effects by name."""
    found = [
        import_module(f"{effects.__name__}.{info.name}")
        for info in iter_modules(effects.__path__)
        if info.name != "effect"
    ]
    return {module.EFFECT.name: module.EFFECT for module in found}


def directions(bench: Bench, names: Sequence[str]) -> list[Direction]:
    """One along each coordinate."""
    model, eye = bench.model, np.eye(bench.model.d)
    return [
        Direction(name, eye[i], float(model.inertia[i, i]), float(model.rest[i]))
        for i, name in enumerate(names)
    ]


def instances(
    bench: Bench,
    residual: Float64[np.ndarray, "N d"],
    *,
    q_names: Sequence[str],
    u_names: Sequence[str],
    without: Sequence[str],
) -> list[Instance]:
    """The catalogue at every place; ``residual`` [1/s^2] is where pushes and lines are looked for."""
    places = directions(bench, q_names)
    out: list[Instance] = []
    for effect in catalogue().values():
        if effect.name in without:
            continue
        for variant in effect.variants:
            if effect.along == "channels" or isinstance(effect, InputChange):
                out += _on_inputs(effect, bench, u_names)
            elif effect.along == "whole":
                out.append(Instance(effect, whole_scales(bench), variant))
            else:
                out += _along(effect, variant, bench, places, residual)
                if effect.along == "both" and (bench.model.d > 1 or not isinstance(effect, Force)):
                    out.append(Instance(effect, whole_scales(bench), variant))
    return [one for one in out if one.scales.reach > 0.0]


def _along(
    effect: Effect, variant: str, bench: Bench, places: list[Direction], residual: np.ndarray
) -> list[Instance]:
    if variant == "weight" or (effect.name == "mass_change" and len(bench.model.mass) == 1 == bench.model.d):
        return []  # weight acts on the whole; a constant mass of one coordinate is the whole
    out = []
    for i, place in enumerate(places):
        one = Instance(effect, scales(bench, place, variant), variant, place)
        if effect.name == "external_push":
            one = replace(one, grid=tuple((time,) for time in events(bench, residual[:, i], one.scales)))
        if effect.name == "external_periodic_force":
            one = replace(one, grid=tuple((line,) for line in lines(bench, residual[:, i], one.scales)))
        out.append(one)
    return out


def _on_inputs(effect: Effect, bench: Bench, u_names: Sequence[str]) -> list[Instance]:
    driven = [j for j in range(bench.record.u.shape[1]) if np.ptp(bench.record.u[:, j]) > 0.0]
    if not driven:
        return []
    if effect.along == "whole":
        return [Instance(effect, whole_scales(bench))]
    out = []
    for j in driven:
        u = bench.record.u[:, j]
        base = whole_scales(bench)
        size = replace(base, input=float(np.sqrt(np.mean(u * u))), input_reach=float(np.abs(u).max()))
        out.append(Instance(effect, size, channel=j, input_name=u_names[j]))
    return out


def scales(bench: Bench, place: Direction, variant: str = "") -> Scales:
    """Sizes of the recorded motion along a direction."""
    s = (bench.smooth - bench.model.rest) @ place.covector
    v = bench.record.v @ place.covector
    reach = {"upper": s.max(), "lower": -s.min()}.get(variant, np.abs(s).max())
    size = float(np.sqrt(np.mean(s * s)))
    return Scales(
        coordinate=size,
        velocity=max(float(np.sqrt(np.mean(v * v))), 1e-6 * size),
        reach=float(reach) if reach > 0.3 * size else 0.0,
        stiffness=_stiffness(bench, place),
        frame_s=bench.record.dt_s,
        duration_s=float(max(bench.record.time[b - 1] for _, b in bench.record.clips)),
    )


def _stiffness(bench: Bench, place: Direction) -> float:
    p = place.covector
    return float(p @ bench.model.stiffness @ p) / float(p @ bench.model.inertia @ p)


def whole_scales(bench: Bench) -> Scales:
    """Sizes of the coordinate that moves most, by its kinetic energy."""
    energy = np.diag(bench.model.inertia) * np.mean(bench.record.v**2, axis=0)
    i = int(np.argmax(energy))
    return scales(bench, Direction(None, np.eye(bench.model.d)[i], float(bench.model.inertia[i, i])))


def events(bench: Bench, residual: np.ndarray, size: Scales) -> list[float]:
    """The instants at which the residual acceleration, averaged over a radian, is largest; in units of time."""
    record, unit = bench.record, size.of("time")
    width = max(3, round(unit / record.dt_s))
    mean = np.convolve(residual, np.ones(width) / width, mode="same")
    peaks, found = find_peaks(np.abs(mean), distance=2 * width, height=0.0)
    best = peaks[np.argsort(found["peak_heights"])[::-1][:EVENTS]]
    return [float(record.time[n] / unit) for n in best]


def lines(bench: Bench, residual: np.ndarray, size: Scales) -> list[float]:
    """The angular frequencies at which the residual is largest, in units of the motion's own rate.

    From the longest file, at even instants.
    """
    record = bench.record
    spans = [
        (record.clips[record.file_of == n][0, 0], record.clips[record.file_of == n][-1, 1])
        for n in range(len(record.files))
    ]
    start, stop = max(spans, key=lambda span: span[1] - span[0])
    time = np.arange(record.time[start], record.time[stop - 1], record.dt_s)
    x = np.interp(time, record.time[start:stop], residual[start:stop])
    spectrum = np.abs(np.fft.rfft((x - x.mean()) * np.hanning(len(x)), 4 * len(x)))
    grid = 2.0 * np.pi * np.fft.rfftfreq(4 * len(x), record.dt_s)
    power = np.where(grid < 2.0 * np.pi * 0.2 / record.dt_s, spectrum, 0.0)
    peaks, found = find_peaks(power[2:], height=0.0)
    best = peaks[np.argsort(found["peak_heights"])[::-1][:LINES]] + 2
    return [float(grid[i] / size.of("rate")) for i in best]
