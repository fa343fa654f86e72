"""Velocity-Verlet rollouts of the learned dynamics, and training windows cut from a trajectory."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from lagsplat.array_types import Inputs, Latents
from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2.lagrangian import Lagrangian, PreparedCoefficients

Steps = float | Float[Tensor, "*B n"]
"""Lengths of the steps of a rollout: one for all, one per step, or one per sample and step."""


@torch.no_grad()
def rollout(
    lagrangian: Lagrangian, q0: Latents, v0: Latents, inputs: Float[Tensor, "B N n_u"], *, dt_s: Steps
) -> tuple[Float[Tensor, "B N d"], Float[Tensor, "B N d"]]:
    """Roll out states and velocities [1/s] at ``N`` instants ``dt_s`` apart; the first is the given one.

    Input ``i`` is constant from state ``i`` to ``i + 1``; the last one is unused. Divergence never raises: a
    row that overflows is NaN from there on.

    ``dt_s`` [s] is one number, or ``N - 1`` of them for all rows or for each row.
    """
    unit = float(lagrangian.time_unit_s)
    ready, inputs = lagrangian.prepare(), inputs.double()
    q, v, steps = q0.double(), v0.double() * unit, dt_s / unit
    positions, velocities = [q], [v]
    for i in range(inputs.shape[1] - 1):
        q, v = advance(lagrangian, q, v, inputs[:, i], step=choose_step(steps, i), ready=ready)
        finite = torch.isfinite(q).all(1, keepdim=True) & torch.isfinite(v).all(1, keepdim=True)
        q, v = q.where(finite, torch.nan), v.where(finite, torch.nan)
        positions.append(q)
        velocities.append(v)
    return torch.stack(positions, 1), torch.stack(velocities, 1) / unit


Step = float | Float[Tensor, "#B 1"] | Float[Tensor, "1"]
"""Length of one step in internal time units: one for all samples, or one per sample."""


def choose_step(steps: Steps, i: int) -> Step:
    """The length of step ``i``."""
    return steps[..., i, None] if isinstance(steps, Tensor) else steps


def split_inputs(step: Step, longest: float) -> int:
    """Count the equal pieces, at most ``longest``, into which a step is divided for all samples."""
    length = float(step.max()) if isinstance(step, Tensor) else step
    return max(1, math.ceil(length / longest - 1e-9))


def advance(
    lagrangian: Lagrangian, q: Latents, v: Latents, u: Inputs, *, step: Step, ready: PreparedCoefficients
) -> tuple[Latents, Latents]:
    """Advance by ``step`` internal time units under a constant input, in as many Verlet steps as needed.

    An explicit step of length h turns a frequency w into ``w (1 + (w h)^2 / 24)``. A law fitted with long
    steps would compensate for that and be wrong by as much, hence `Lagrangian.longest_step`.
    """
    pieces = split_inputs(step, lagrangian.longest_step)
    for _ in range(pieces):
        q, v = verlet_step(lagrangian, q, v, u, step=step / pieces, ready=ready)
    return q, v


def verlet_step(
    lagrangian: Lagrangian, q: Latents, v: Latents, u: Inputs, *, step: Step, ready: PreparedCoefficients
) -> tuple[Latents, Latents]:
    """Make one velocity-Verlet step of order two under a constant input.

    The second evaluation uses the velocity predicted for the end of the step. The usual half-step velocity
    would evaluate damping at a quarter of the step on average, which is of order one only.
    """
    a = lagrangian.acceleration(q, v, u, ready=ready)
    half = v + (0.5 * step) * a
    q_next = q + step * half
    a_next = lagrangian.acceleration(q_next, half + (0.5 * step) * a, u, ready=ready)
    return q_next, half + (0.5 * step) * a_next


@dataclass(frozen=True)
class ShootingWindows:
    """Pairs of states ``step`` internal time units apart, one for all or each, and the input between them."""

    q: Latents
    v: Latents
    u: Inputs
    q_next: Latents
    v_next: Latents
    step: Step

    def __len__(self) -> int:
        return self.q.shape[0]

    def pick(self, index: Int[Tensor, " b"]) -> "ShootingWindows":
        """The windows at ``index``."""
        parts = vars(self).values()
        return ShootingWindows(*(part[index] if isinstance(part, Tensor) else part for part in parts))


def list_starts(trajectory: EncodedTrajectory, *, before: int, after: int) -> Int[np.ndarray, " n"]:
    """List the frames with ``before`` earlier and ``after`` later frames in their segment."""
    ranges = [np.arange(a + before, b - after) for a, b in trajectory.segments]
    return np.concatenate([frames for frames in ranges if len(frames)] or [np.arange(0)])


def list_one_step_windows(
    trajectory: EncodedTrajectory, *, stride_frames: int, time_unit_s: float
) -> ShootingWindows:
    """Cut windows of four samples ``stride_frames`` apart: a state and a target with central velocities.

    Sample 1 with the slope from 0 to 2 is the state, sample 2 with the slope from 1 to 3 the target. Slopes
    and steps use the true times.

    Raises:
        ValueError: no segment is as long as a window.

    Source: paper eq. (physics_loss), facts of the published protocol.
    """
    k = stride_frames
    at = list_starts(trajectory, before=k, after=2 * k)
    if not len(at):
        longest = max((b - a for a, b in trajectory.segments), default=0)
        raise ValueError(
            f"the longest training segment has {longest} frames and a one-step window needs {3 * k + 1}: "
            "record longer clips or lower stage2.stride_frames"
        )
    clock, latents = trajectory.clock, trajectory.latents
    q, u, index = (torch.from_numpy(series) for series in (latents, trajectory.inputs, at))
    return ShootingWindows(
        q=q[index],
        v=torch.from_numpy(clock.slope(latents, at, (-k, k))) * time_unit_s,
        u=u[index],
        q_next=q[index + k],
        v_next=torch.from_numpy(clock.slope(latents, at + k, (-k, k))) * time_unit_s,
        step=convert_units(clock.elapsed_s(at, k), time_unit_s),
    )


@dataclass(frozen=True)
class ShootingTargets:
    """Initial states with the inputs and latents that follow them frame by frame.

    ``steps`` is the time between frames in the unit of the velocities: one number, or one row per sample.
    """

    q: Latents
    v: Latents
    inputs: Float[Tensor, "B N n_u"]
    targets: Float[Tensor, "B N d"]
    steps: Steps


def convert_units(
    time_s: float | Float[np.ndarray, "B n"], time_unit_s: float
) -> float | Float[Tensor, "B n"]:
    """Convert times [s] to internal time units."""
    if isinstance(time_s, np.ndarray):
        return torch.from_numpy(time_s / time_unit_s)
    return time_s / time_unit_s


def cut_shooting_targets(
    trajectory: EncodedTrajectory, at: Int[np.ndarray, " B"], *, n_states: int, time_unit_s: float
) -> ShootingTargets:
    """Cut targets of ``n_states`` frames that begin at the frames ``at``.

    Initial velocities are estimated from two frames on either side.
    """
    rows = torch.from_numpy(at)[:, None] + torch.arange(n_states)
    q = torch.from_numpy(trajectory.latents)[rows]
    v = torch.from_numpy(trajectory.clock.slope(trajectory.latents, at, (-2, -1, 1, 2))) * time_unit_s
    steps = convert_units(trajectory.clock.steps_s(at, n_states), time_unit_s)
    return ShootingTargets(q[:, 0], v, torch.from_numpy(trajectory.inputs)[rows], q, steps)
