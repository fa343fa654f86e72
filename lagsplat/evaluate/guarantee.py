"""Test on a trained law what its class guarantees: energy never rises, and every motion settles."""

from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.chart.chart import Chart
from lagsplat.evaluate.config import GuaranteeConfig
from lagsplat.evaluate.forces.known_forces import mechanical_energy
from lagsplat.stage2.lagrangian import Lagrangian, find_equilibrium
from lagsplat.stage2.numpy_lagrangian import NumpyLagrangian, roll_out_free
from lagsplat.stage2.rollout import split_inputs

HALVINGS = 6
STRETCH = 400  # states between two checks that everything has settled
LARGE = 0.1  # relative rise of the energy above which the step is halved
NOISE = 1e-9  # rise of the energy, over the initial energy, that is rounding
ORDER = 2  # of the integrator: halving the step divides its own energy rise by four


def measure_guarantee(lagrangian: Lagrangian, chart: Chart, config: GuaranteeConfig) -> dict[str, Any]:
    """The guarantee of a law on the chart of its training, or the ``reason`` why it cannot be tested."""
    if lagrangian.form.mass == "induced":
        return {"reason": "a decoder-induced mass has no closed form to roll out for so long"}
    reach = float(np.linalg.norm(chart.latents - chart.rest, axis=1).max())
    return {"reason": "", **summarize_guarantees(lagrangian, reach=reach, dt_s=chart.dt_s, config=config)}


@dataclass(frozen=True)
class SettlingTest:
    """Rollouts that ran until they settled or their time was over.

    ``rise`` is the largest rise of the energy above an earlier value, over the initial energy. ``settled``
    counts rollouts that came within the tolerance of their goal, ``diverged`` those that became non-finite,
    ``step_s`` is the step at which the scheme added no energy.
    """

    ends: Float64[np.ndarray, "B d"]
    settled: int
    diverged: int
    rise: float
    time_s: float
    step_s: float


def summarize_guarantees(
    lagrangian: Lagrangian, *, reach: float, dt_s: float, config: GuaranteeConfig, seed: int = 0
) -> dict[str, Any]:
    """Whether a trained law comes to rest from anywhere, without load and under constant forces; plain data.

    ``free`` starts at ``far`` times ``reach`` in all directions, at rest and moving, and must end at the
    minimum of the potential. ``held`` is pushed by forces that balance ``dV/dq`` at states of the data's
    size, and must end at these states. ``rise`` and ``rise_at_half_step`` are of the free rollouts at
    ``step_s`` and at half of it: the integrator's share falls to a quarter, the law's would not. The step is
    halved until that is visible. ``holds`` is the conclusion.

    Args:
        lagrangian: the trained law.
        reach, dt_s: length of the longest encoded state, and longest step [s].
        config, seed: starts, forces and tolerances, and their random seed.

    Source: paper, Appendix "Bounded forced response".
    """
    law = NumpyLagrangian(lagrangian)
    # The workflow divides a long step into equal pieces; here a step is one step of the scheme.
    dt_s = dt_s / split_inputs(dt_s / law.unit_s, law.longest_step)
    law.longest_step = np.inf
    rest = find_equilibrium(lagrangian, torch.zeros(lagrangian.n_inputs, dtype=torch.float64)).numpy()
    rng = np.random.default_rng(seed)
    sides = _sides(rng, config.starts, lagrangian.d)
    start = rest + config.far * reach * sides
    speed = config.far * reach / law.unit_s * _sides(rng, config.starts, lagrangian.d)
    moving = np.arange(config.starts)[:, None] % 2 * speed
    tolerance = config.settled * reach
    fine_s, half = _step_in_order(lagrangian, law, start, moving, dt_s)
    free = _settle(
        lagrangian, law, start, moving, np.broadcast_to(rest, start.shape), fine_s, config, tolerance
    )
    held_at = rest + config.force * reach * sides
    force = -law.conservative_force(held_at)
    still = np.zeros_like(held_at)
    begin = np.broadcast_to(rest, held_at.shape).copy()
    held = _settle(lagrangian, law, begin, still, held_at, dt_s, config, tolerance, force=force)
    missed = np.abs(-law.conservative_force(held.ends) - force).max() / max(np.abs(force).max(), 1e-300)
    order = _falls_in_order(free.rise, half)
    return {
        "starts": config.starts,
        "far": config.far,
        "step_s": free.step_s,
        "rise": free.rise,
        "rise_at_half_step": half,
        "free_settled": free.settled,
        "free_diverged": free.diverged,
        "free_time_s": free.time_s,
        "held_settled": held.settled,
        "held_diverged": held.diverged,
        "held_time_s": held.time_s,
        "held_force_error": float(missed),
        "holds": bool(order and free.settled == held.settled == config.starts),
    }


def _step_in_order(
    lagrangian: Lagrangian, law: NumpyLagrangian, q: np.ndarray, v: np.ndarray, dt_s: float
) -> tuple[float, float]:
    """The longest step at which the energy rise is small and of the scheme's order, and the rise at half of
    it.
    """
    rise = _rise(lagrangian, law, q, v, dt_s=dt_s)
    for halvings in range(HALVINGS + 1):
        half = _rise(lagrangian, law, q, v, dt_s=dt_s / 2, states=2 * STRETCH + 1)
        if halvings == HALVINGS or (rise < LARGE and _falls_in_order(rise, half)):
            break
        rise, dt_s = half, dt_s / 2
    return dt_s, half


def _falls_in_order(rise: float, half: float) -> bool:
    return rise <= NOISE or half <= max(NOISE, 1.5 * rise / 2**ORDER)


def _sides(rng: np.random.Generator, count: int, d: int) -> np.ndarray:
    """Unit vectors in all directions; in one dimension both directions in turn."""
    if d == 1:
        return np.where(np.arange(count)[:, None] // 2 % 2 == 0, 1.0, -1.0)
    drawn = rng.normal(size=(count, d))
    return drawn / np.linalg.norm(drawn, axis=1, keepdims=True)


def _settle(
    lagrangian: Lagrangian,
    law: NumpyLagrangian,
    q: np.ndarray,
    v: np.ndarray,
    goal: np.ndarray,
    dt_s: float,
    config: GuaranteeConfig,
    tolerance: float,
    *,
    force: np.ndarray | float = 0.0,
) -> SettlingTest:
    """Roll out until all are at their goal; a step at which the scheme adds energy is halved."""
    for _ in range(HALVINGS):
        if _rise(lagrangian, law, q, v, dt_s=dt_s, force=force) < LARGE:
            break
        dt_s /= 2
    rise, elapsed_s = _rise(lagrangian, law, q, v, dt_s=dt_s, force=force), 0.0
    while elapsed_s < config.duration_s:
        paths, speeds = roll_out_free(law, q, v, states=STRETCH + 1, dt_s=dt_s, load=force)
        q, v, elapsed_s = paths[:, -1], speeds[:, -1], elapsed_s + STRETCH * dt_s
        # a passage through the goal does not count: the whole interval must lie at it
        apart = np.linalg.norm(paths - goal[:, None], axis=2).max(axis=1)
        if not np.isfinite(q).all() or (apart < tolerance).all():
            break
    finite = np.isfinite(q).all(axis=1)
    near = finite & (np.nan_to_num(apart, nan=np.inf) < tolerance)
    return SettlingTest(q, int(near.sum()), int((~finite).sum()), rise, elapsed_s, dt_s)


def _rise(
    lagrangian: Lagrangian,
    law: NumpyLagrangian,
    q: np.ndarray,
    v: np.ndarray,
    *,
    dt_s: float,
    force: np.ndarray | float = 0.0,
    states: int = STRETCH + 1,
) -> float:
    """Largest rise of the energy over an earlier moment, over the initial energy; infinite on divergence."""
    paths, speeds = roll_out_free(law, q, v, states=states, dt_s=dt_s, load=force)
    if not (np.isfinite(paths).all() and np.isfinite(speeds).all()):
        return float("inf")
    push = np.broadcast_to(force, q.shape)
    worst = 0.0
    for path, speed, held in zip(paths, speeds, push, strict=True):
        energy = mechanical_energy(lagrangian, path, speed) - (path - path[0]) @ held
        scale = max(float(energy[0]), float(np.ptp(energy)), 1e-300)
        worst = max(worst, float((energy - np.minimum.accumulate(energy)).max()) / scale)
    return worst
