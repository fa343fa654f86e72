"""Test on a trained law what its class guarantees: energy never rises, and every motion settles."""

import math
from dataclasses import dataclass
from typing import Any

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.chart.chart import Chart
from lagsplat.chart.trajectory import TimeBase
from lagsplat.evaluate.config import GuaranteeConfig
from lagsplat.evaluate.protocol import STENCILS
from lagsplat.stage2.equilibrium import NoEquilibriumError, find_equilibrium
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.stage2.numpy_lagrangian import NumpyLagrangian, roll_out_free
from lagsplat.stage2.rollout import split_inputs

HALVINGS = 6
STRETCH = 400  # states between two checks that everything has settled, at most
LARGE = 0.1  # relative rise of the energy above which the step is halved
NOISE = 1e-9  # rise of the energy, over the initial energy, that is rounding
ORDER = 2  # of the integrator: halving the step divides its own energy rise by four


def measure_guarantee(lagrangian: Lagrangian, chart: Chart, config: GuaranteeConfig) -> dict[str, Any]:
    """The guarantee of a law on the chart of its training, or the ``reason`` why it cannot be tested."""
    if lagrangian.form.mass == "induced":
        return {"reason": "a decoder-induced mass has no closed form to roll out for so long"}
    reach = float(np.linalg.norm(chart.latents - chart.rest, axis=1).max())
    try:
        found = summarize_guarantees(lagrangian, reach=reach, dt_s=chart.dt_s, config=config)
    except NoEquilibriumError:
        return {"reason": "the law has no equilibrium"}
    return {"reason": "", **found}


def summarize_guarantees(
    lagrangian: Lagrangian, *, reach: float, dt_s: float, config: GuaranteeConfig
) -> dict[str, Any]:
    """Whether a trained law comes to rest from anywhere, without load and under constant forces; plain data.

    ``free`` starts at ``far`` times ``reach`` in all directions, at rest and moving, and must end at the
    minimum of the potential. ``held`` is pushed by forces that balance ``dV/dq`` at states of the data's
    size, and must end at these states. ``rise`` and ``rise_at_half_step`` are of the free rollouts at
    ``step_s`` and at half of it: the integrator's share falls to a quarter, the law's would not. The step is
    halved until that is visible. ``holds`` is the conclusion.

    Args:
        lagrangian, config: the trained law, and the starts, forces and tolerances.
        reach, dt_s: length of the longest encoded state, and longest step [s].

    Raises:
        NoEquilibriumError: the law has none without inputs.

    Source: paper, Appendix "Bounded forced response".
    """
    law = NumpyLagrangian(lagrangian)
    # The workflow divides a long step into equal pieces; here a step is one step of the scheme.
    dt_s = dt_s / split_inputs(dt_s / law.unit_s, law.longest_step)
    law.longest_step = np.inf
    rest = find_equilibrium(lagrangian).numpy()
    rng = np.random.default_rng(0)
    sides = _sides(rng, config.starts, lagrangian.d)
    start = rest + config.far * reach * sides
    speed = config.far * reach / law.unit_s * _sides(rng, config.starts, lagrangian.d)
    moving = np.arange(config.starts)[:, None] % 2 * speed
    tolerance = config.settled * reach
    at_rest = np.broadcast_to(rest, start.shape).copy()
    free_trial = Trial(lagrangian, law, config.duration_s, start, moving, at_rest)
    fine_s, half = free_trial.find_step(dt_s)
    free = free_trial.settle(fine_s, tolerance)
    held_at = rest + config.force * reach * sides
    force = -law.conservative_force(held_at)
    held_trial = Trial(lagrangian, law, config.duration_s, at_rest, np.zeros_like(held_at), held_at, force)
    held = held_trial.settle(dt_s, tolerance)
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


@dataclass(frozen=True)
class Settled:
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


@dataclass(frozen=True)
class Trial:
    """Motions of a law from ``q`` and ``v`` under constant forces, which must end at their ``goal``.

    None of them is followed for longer than ``duration_s``.
    """

    lagrangian: Lagrangian
    law: NumpyLagrangian
    duration_s: float
    q: Float64[np.ndarray, "B d"]
    v: Float64[np.ndarray, "B d"]
    goal: Float64[np.ndarray, "B d"]
    force: Float64[np.ndarray, "B d"] | float = 0.0

    def stretch(self, dt_s: float) -> int:
        """Steps between two checks."""
        return min(STRETCH, max(1, math.ceil(self.duration_s / dt_s)))

    def rise(self, dt_s: float, *, steps: int | None = None) -> float:
        """Largest rise of the energy above an earlier value, over the initial one; infinite on divergence."""
        states = (self.stretch(dt_s) if steps is None else steps) + 1
        paths, speeds = roll_out_free(self.law, self.q, self.v, states=states, dt_s=dt_s, load=self.force)
        if not (np.isfinite(paths).all() and np.isfinite(speeds).all()):
            return float("inf")
        worst = 0.0
        for path, speed, held in zip(paths, speeds, np.broadcast_to(self.force, self.q.shape), strict=True):
            energy = mechanical_energy(self.lagrangian, path, speed) - (path - path[0]) @ held
            scale = max(float(energy[0]), float(np.ptp(energy)), 1e-300)
            worst = max(worst, float((energy - np.minimum.accumulate(energy)).max()) / scale)
        return worst

    def find_step(self, dt_s: float) -> tuple[float, float]:
        """The longest step at which the energy rise is small and of the scheme's order, and the rise at half
        of it.
        """
        rise = self.rise(dt_s)
        for halvings in range(HALVINGS + 1):
            half = self.rise(dt_s / 2, steps=2 * self.stretch(dt_s))
            if halvings == HALVINGS or (rise < LARGE and _falls_in_order(rise, half)):
                break
            rise, dt_s = half, dt_s / 2
        return dt_s, half

    def settle(self, dt_s: float, tolerance: float) -> Settled:
        """Roll out until all are at their goal; a step at which the scheme adds energy is halved."""
        rise, halvings = self.rise(dt_s), 0
        while not rise < LARGE and halvings < HALVINGS:
            dt_s, halvings = dt_s / 2, halvings + 1
            rise = self.rise(dt_s)
        elapsed_s, q, v, steps = 0.0, self.q, self.v, self.stretch(dt_s)
        while elapsed_s < self.duration_s:
            paths, speeds = roll_out_free(self.law, q, v, states=steps + 1, dt_s=dt_s, load=self.force)
            q, v, elapsed_s = paths[:, -1], speeds[:, -1], elapsed_s + steps * dt_s
            # a passage through the goal does not count: the whole interval must lie at it
            apart = np.linalg.norm(paths - self.goal[:, None], axis=2).max(axis=1)
            if not np.isfinite(q).all() or (apart < tolerance).all():
                break
        finite = np.isfinite(q).all(axis=1)
        near = finite & (np.nan_to_num(apart, nan=np.inf) < tolerance)
        return Settled(q, int(near.sum()), int((~finite).sum()), rise, elapsed_s, dt_s)


def _falls_in_order(rise: float, half: float) -> bool:
    return rise <= NOISE or half <= max(NOISE, 1.5 * rise / 2**ORDER)


def _sides(rng: np.random.Generator, count: int, d: int) -> np.ndarray:
    """Unit vectors in all directions; in one dimension both directions in turn."""
    if d == 1:
        return np.where(np.arange(count)[:, None] // 2 % 2 == 0, 1.0, -1.0)
    drawn = rng.normal(size=(count, d))
    return drawn / np.linalg.norm(drawn, axis=1, keepdims=True)


@torch.no_grad()
def mechanical_energy(
    lagrangian: Lagrangian, q: Float64[np.ndarray, "N d"], v: Float64[np.ndarray, "N d"]
) -> Float64[np.ndarray, " N"]:
    """``v.M v / 2 + V`` at states and velocities [1/s], in the law's unit of energy."""
    states = torch.from_numpy(np.ascontiguousarray(q))
    w = torch.from_numpy(np.ascontiguousarray(v)) * float(lagrangian.time_unit_s)
    kinetic = 0.5 * torch.einsum("bi,bij,bj->b", w, lagrangian.mass(states), w)
    return (kinetic + lagrangian.potential(states)).numpy()


def measure_energy(
    lagrangian: Lagrangian, states: Float64[np.ndarray, "N d"], dt_s: float
) -> Float64[np.ndarray, " M"]:
    """The energy along evenly spaced states, by fourth-order differences.

    Two states at either end are left out, because their differences would need states beyond the series.
    Every model is measured this way, even one that knows its velocity.
    """
    inner = np.arange(2, len(states) - 2)
    speeds = TimeBase(dt_s).slope(states, inner, STENCILS["central"])
    return mechanical_energy(lagrangian, states[inner], speeds)
