"""Add an effect of your own to the catalogue, and find it in a recording: friction in one direction only."""

import numpy as np
from scipy.integrate import solve_ivp

import lagsplat
from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal
from lagsplat.diagnose.effects.registry import catalogue, register_effect
from lagsplat.diagnose.solvers.force_laws import compile_force_law


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
    title="a ratchet",
    kind="mechanism",
    what="A pawl rubs in one direction of motion only.",
    symptom="Swings in one direction are shorter.",
    remedy="Add the friction of the pawl to the simulation.",
    mujoco="the friction loss of a joint is the same in both directions",
)


def simulate(strength: float, seed: int) -> dict[str, np.ndarray]:
    """A driven pendulum, sampled for 8 s at 40 Hz with a little noise."""
    t = np.arange(320) / 40
    u = 4 * np.sin(3.0 * t + seed) + 3 * np.sin(7.3 * t)

    def rate(time: float, x: np.ndarray) -> tuple[float, float]:
        rub = strength * 0.5 * (1 + np.tanh(20 * x[1]))
        return x[1], -20 * np.sin(x[0]) - 0.3 * x[1] - rub + np.interp(time, t, u)

    q = solve_ivp(rate, (0, 8), (1, 0), t_eval=t, rtol=1e-8).y
    return {"t": t, "q": q[:1].T + 0.003 * np.random.default_rng(seed).normal(size=(320, 1)), "u": u[:, None]}


register_effect(EFFECT)
others = sorted(set(catalogue()) - {"ratchet", "coulomb_friction", "constant_force"})  # to save time
diagnosis = lagsplat.diagnose(simulate(strength=0.0, seed=1), simulate(strength=2.0, seed=2), without=others)
best = diagnosis.candidates[0]
print(f"{diagnosis.verdict}: {best.name} ({best.probability:.2f}), {best.parameters}")
