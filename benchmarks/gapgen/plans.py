"""How recordings are driven: releases by hand or excitations, to the reach of the mechanism."""

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from benchmarks.gapgen.effect import Setting
from benchmarks.gapgen.inputs import SINE, excitation, pure_sine
from benchmarks.gapgen.mechanisms import Mechanism
from benchmarks.gapgen.motion import Clip, Plan
from benchmarks.gapgen.sources import world_of

Array = NDArray[np.float64]


def free_plan(m: Mechanism, dt: float, span: float, f1: float, rng: np.random.Generator) -> Plan:
    """Releases by hand from several heights, one a clip, ``span`` seconds in all."""
    n_clips = int(np.clip(round(span * f1 / 7.0), 1, 6))
    if span < 6.0 and rng.random() < 0.5:
        n_clips = 2
    levels = rng.permutation(np.geomspace(1.0, 0.3, n_clips)) if n_clips > 1 else np.array([1.0])
    plan = Plan(dt, [], [], [], [])
    start = 0.0
    shares = rng.dirichlet(np.full(n_clips, 30.0))
    for k in range(n_clips):
        n = max(round(shares[k] * span / dt), 20)
        shape = rng.uniform(-1.0, 1.0, m.d)
        shape = shape / np.abs(shape).max()
        v0 = rng.normal(0.0, 0.02, m.d) * m.size * 2.0 * np.pi * f1
        plan.start_s.append(start)
        plan.x0.append(np.concatenate([levels[k] * m.size * shape, v0]))
        plan.lead.append(0)
        plan.inputs.append(np.zeros((n, m.n_u)))
        start += (n - 1) * dt + rng.uniform(0.5, 2.0)
    return plan


def forced_plan(
    m: Mechanism, dt: float, span: float, f1: float, rng: np.random.Generator, kinds: tuple[str, ...]
) -> Plan:
    """One clip whose response reaches the size of the mechanism; inputs in the mechanism's present units."""
    lead, n = round(4.0 / dt), round(span / dt) + 1
    t = (np.arange(lead + n) - lead) * dt
    if kinds == (SINE,):
        shape = pure_sine(t, f1, m.n_u, rng)
    else:
        shape = np.concatenate(
            [
                excitation(t[:lead], f1, m.n_u, rng, kinds=("multisine",)),
                excitation(t[lead:], f1, m.n_u, rng, kinds=kinds),
            ]
        )
    # a static push to the full reach is the first guess
    per_input = np.abs(np.linalg.solve(m.stiffness_at_rest(), m.b)) / m.size[:, None]
    amount = 0.3 / np.maximum(per_input.max(0), 1e-12)
    world = world_of(m)
    for _ in range(4):
        plan = Plan(dt, [0.0], [np.zeros(2 * m.d)], [lead], [shape * amount])
        try:
            top = np.abs(world.move(plan)[0].x[:, : m.d] / m.size).max()
        except FloatingPointError:
            top = 6.0
        amount = amount * np.clip(0.98 / top, 0.2, 4.0)
        if 0.9 < top < 1.1:
            break
    return plan


def rescale_inputs(m: Mechanism, plan: Plan, rng: np.random.Generator) -> tuple[Mechanism, Array]:
    """Inputs in units of their own: the mechanism in them and the factor (n_u,) to apply to every input."""
    peak = np.abs(np.concatenate(plan.inputs)).max(0)
    factor = np.exp(rng.uniform(np.log(0.2), np.log(5.0))) / np.maximum(peak, 1e-9).max() * np.ones(m.n_u)
    return replace(m, b=m.b / factor), factor


def setting_of(m: Mechanism, clips: list[Clip], plan: Plan, *, forced: bool, span: float) -> Setting:
    """Scales of the nominal motion ``clips``, by which effects are sized."""
    x = np.concatenate([c.x for c in clips])
    q, v = x[:, : m.d], x[:, m.d : 2 * m.d]
    u = np.concatenate([c.u for c in clips])
    inertia, stiffness = np.diag(m.inertia_at_rest()), np.diag(m.stiffness_at_rest())
    w = np.sqrt(stiffness / inertia)
    return Setting(
        f1_hz=w / (2.0 * np.pi),
        x=np.sqrt((q**2).mean(0)),
        v=np.sqrt((v**2).mean(0)),
        top=np.abs(q).max(0),
        v_top=np.abs(v).max(0),
        u=np.sqrt((u**2).mean(0)) + 1e-12,
        u_top=np.abs(u).max(0) + 1e-12,
        zeta=m.damping_at_rest() / (2.0 * w * inertia),
        span_s=span,
        dt_s=plan.dt_s,
        forced=forced,
        system=m.system,
        inertia=inertia.copy(),
        gain=m.b / inertia[:, None],
    )
