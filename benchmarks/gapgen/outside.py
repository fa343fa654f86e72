"""Effects of no catalogue entry, for which a diagnosis must say that it does not know."""

import numpy as np

from benchmarks.gapgen import laws
from benchmarks.gapgen.effect import Effect, Maker, Setting


def outside(name: str, s: Setting, i: int, j: int, rng: np.random.Generator) -> Maker:
    """Effects of no catalogue entry."""
    w = 2.0 * np.pi * s.f1_hz[i]
    force = w**2 * s.x[i]
    phase, centre = rng.uniform(0.0, 6.2), rng.uniform(-0.8, 0.8) * s.x[i]
    waves, side = rng.uniform(2.5, 6.0), (1.0 if rng.random() < 0.5 else -1.0)
    f = s.f1_hz[i] * rng.uniform(0.3, 2.6)
    when = rng.uniform(0.35, 0.65) * s.span_s

    def make(a: float) -> Effect:
        if name == "cogging":
            numbers, law = [a * force, waves / s.x[i], phase], laws.COGGING
        elif name == "parametric_excitation":
            numbers, law = [a, 2.0 * np.pi * f, phase, w**2], laws.PARAMETRIC
        elif name == "local_damping":
            numbers, law = [a * 4.0 * w, centre, 0.5 * s.x[i]], laws.LOCAL_DAMPING
        elif name == "potential_bump":
            numbers, law = [side * a * 0.8 * force, centre, 0.4 * s.x[i]], laws.BUMP
        elif name == "one_way_damping":
            numbers, law = [a * 2.0 * w, side], laws.ONE_WAY
        elif name == "sudden_change":
            numbers, law = [side * min(a, 0.7) * w**2, when, 0.4 * a * w], laws.SWITCH
        elif name == "random_force":
            numbers, law = [a * force, w, 1.0 + phase], laws.RUMBLE
        elif name == "self_excitation":
            numbers, law = [a * w, s.x[i] * 1.2], laws.SELF_EXCITED
        elif name == "input_stiffness":
            numbers, law = [a * 1.5 * w**2 / s.u_top[j], 0.0], laws.INPUT_STIFFNESS
        elif name == "input_rectification":
            value = {"share": side * a, "scale": float(s.u[j])}
            return Effect(name, operators=[(j, "rectified", value)], parameters=value)
        elif name == "fractional_memory":
            numbers, law = [a * w**2, 0.04 / w, 5.0, 0.5], laws.FRACTIONAL
        elif name == "belt_friction":
            numbers, law = [a * force, side * 0.5 * s.v[i], 0.3 * s.v[i]], laws.BELT
        elif name == "speed_softening":
            numbers, law = [0.9 * min(2.0 * a, 1.0) * w**2, 0.6 * s.v[i]], laws.SPEED_SOFTENING
        else:
            value = {"omega": w * float(1.2 / a**0.5), "zeta": 0.08}
            return Effect(name, operators=[(j, "resonant", value)], parameters=value)
        return Effect(name, [(law, i, j, numbers)], parameters={"numbers": [float(x) for x in numbers]})

    return make
