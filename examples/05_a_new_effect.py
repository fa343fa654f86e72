"""Add an effect of your own to the catalogue, and find it in a recording: friction in one direction only."""

import tempfile
from pathlib import Path

import numpy as np
from scipy.integrate import solve_ivp

from lagsplat.config.compose import compose
from lagsplat.diagnose.effects.base import EffectDescription, ForceEffect, Grade
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal
from lagsplat.diagnose.effects.registry import catalogue, register_effect
from lagsplat.diagnose.solvers.runge_kutta import compile_force_law
from lagsplat.pipelines.diagnosis import diagnose_files


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """Acceleration at speed ``v``; ``theta`` holds the parameters."""
    return -theta[0] * 0.5 * (1.0 + np.tanh(20.0 * v))


EFFECT = ForceEffect(
    name="ratchet",
    group="B",
    equation="a = -acceleration where v > 0",
    parameters=(EffectParameter("acceleration", "acceleration", HalfNormal(0.2)),),
    law=force,
    excitation=lambda m: Grade("yes" if m.periods > 5 else "weak", "it swings", "record more swings"),
    description=EffectDescription(
        title="a ratchet",
        kind="mechanism",
        what="A pawl rubs in one direction of motion only.",
        symptom="Swings in one direction are shorter.",
        remedy="Add the friction of the pawl to the simulation.",
    ),
    mujoco="the friction loss of a joint is the same in both directions",
)


def simulate(path: Path, strength: float, seed: int) -> str:
    """Write a driven pendulum, sampled for 10 s at 40 Hz with a little noise."""
    t = np.arange(400) / 40
    u = 4 * np.sin(3.0 * t + seed) + 3 * np.sin(7.3 * t)
    rub = lambda v: strength * 0.5 * (1 + np.tanh(20 * v))  # noqa: E731
    rate = lambda at, x: (x[1], -20 * np.sin(x[0]) - 0.3 * x[1] - rub(x[1]) + np.interp(at, t, u))  # noqa: E731
    q = solve_ivp(rate, (0, 10), (1, 0), t_eval=t, rtol=1e-8).y[0]
    q += 0.003 * np.random.default_rng(seed).normal(size=400)
    np.savetxt(path, np.stack([t, q, u], axis=1), delimiter=",", header="t,q0,u0", comments="")
    return str(path)


register_effect(EFFECT)
others = set(catalogue()) - {"ratchet", "coulomb_friction", "constant_force"}  # a short list saves time
with tempfile.TemporaryDirectory() as name:
    sim, real = simulate(Path(name, "sim.csv"), 0.0, 1), simulate(Path(name, "real.csv"), 2.0, 2)
    settings = compose(f"diagnose.without=[{','.join(sorted(others))}]").diagnose
    found = diagnose_files(sim, real, Path(name, "out"), settings, command="").candidates[0]
print(f"{found.name} ({found.probability:.2f}): {found.parameters}")
