"""Fitted parameters as they are told: published keys, units, intervals, the clocks of the files."""

from dataclasses import replace
from typing import Any

import numpy as np

from lagsplat.diagnose.compare import Contest, Explained
from lagsplat.diagnose.effects.effect import UNITS, Instance, Noise
from lagsplat.diagnose.record import Record
from lagsplat.diagnose.result import Parameter
from lagsplat.diagnose.verdict import interval


def parameters(contest: Contest, one: Explained, instance: Instance, temper: float) -> dict[str, Parameter]:
    """The fitted parameters of one of the effects, with 90 % intervals, under their published keys."""
    effect, scales = instance.effect, instance.scales
    kinds = {p.name: p.kind for p in effect.parameters}
    if isinstance(effect, Noise):
        sized = {name: [v * scales.of(kinds[name]) for v in values] for name, values in one.noise.items()}
        return {name: Parameter(v[0], v[1], v[2], UNITS[kinds[name]]) for name, v in sized.items()}
    known = [e for e in one.effects if not isinstance(e.effect, Noise)]
    prior = [p.prior for e in known for p in e.effect.parameters]
    low, high = interval(replace(one, effects=tuple(known)), contest.bench.nuisance.deviation, prior, temper)
    cut = one.own(instance)
    rows = instance.physical(np.stack([one.fit.x[cut], low[cut], high[cut]]))
    best, *ends = (told(instance, row, contest.bench.record) for row in rows)
    out = {}
    for key, value in best.items():
        first, second = (end.get(key, value) for end in ends)
        if isinstance(value, list) and not len(first) == len(second) == len(value):
            first = second = value
        elif not isinstance(value, list) and first > second:
            first, second = second, first
        out[key] = Parameter(value, first, second, unit(instance, key))
    return out


def unit(instance: Instance, key: str) -> str:
    """Of what a parameter is told in: its own, that of the first of a list, or that of the effect's first."""
    kinds = {p.name: p.kind for p in instance.effect.parameters}
    if key == "files":
        return "1"
    if key == "added_stiffness":
        return "1/s^2"
    if key.endswith("_hz"):
        return "Hz"
    first = instance.effect.parameters[0].kind
    raw = UNITS[kinds.get(key, kinds.get(f"{key.removesuffix('s')} 0", first))]
    raw = instance.effect.variant_units.get(instance.variant, raw)
    place = next((part.place for part in instance.parts if key.endswith(f" {part.place}")), instance.place)
    name = f"({place})" if place and " " in place else place
    return raw.format(q=name or "q", u=name or "u")


def told(instance: Instance, row: np.ndarray, record: Record) -> dict[str, Any]:
    """The parameters in a row of physical values, by the keys under which they are published."""
    effect = instance.effect
    plain = {
        p.name: float(np.exp(value) if p.kind == "log_ratio" else value)
        for p, value in zip(effect.parameters, row, strict=True)
        if not p.name.startswith("memory ")
    }
    told: dict[str, Any] = effect.reports(plain, instance) if effect.reports is not None else dict(plain)
    if "times" in told:
        places = [record.own_time(time) for time in told["times"]]
        told["times"] = [time for _, time in places]
        if len(record.files) > 1:
            told["files"] = [number for number, _ in places]
    return told
