"""Rollouts of the learned dynamics, and training windows cut from a trajectory."""

import math
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from lagsplat.array_types import Inputs, Latents
from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2.lagrangian import Lagrangian, PreparedCoefficients
from lagsplat.stage2.polynomial_kernels import roll_out
from lagsplat.stage2.polynomials import list_law_arrays
from lagsplat.stage2.runge_kutta import take_runge_kutta_step

Steps = float | Float[Tensor, "*B n"]
"""Lengths of the steps of a rollout: one for all, one per step, or one per sample and step."""


@torch.no_grad()
def rollout(
    lagrangian: Lagrangian, q0: Latents, v0: Latents, inputs: Float[Tensor, "B N n_u"], *, dt_s: Steps
) -> tuple[Float[Tensor, "B N d"], Float[Tensor, "B N d"]]:
    """Roll out states and velocities [1/s] at ``N`` instants ``dt_s`` apart; the first is the given one.

    Input ``i`` is constant from state ``i`` to ``i + 1`` and the last one is unused, unless the law is
    integrated by the Runge-Kutta method, which interpolates the inputs. Divergence never raises: a row that
    overflows is NaN from there on. A law of polynomial terms is rolled out in its own coordinates, by
    compiled code.

    ``dt_s`` [s] is one number, or ``N - 1`` of them for all rows or for each row.
    """
    if lagrangian.energy is None or inputs.shape[1] < 2:
        return rollout_in_torch(lagrangian, q0, v0, inputs, dt_s=dt_s)
    energy, mass, damping = lagrangian.polynomials
    coordinates, unit, d = lagrangian.coordinates, float(lagrangian.time_unit_s), lagrangian.d
    assert coordinates is not None
    steps = torch.as_tensor(dt_s, dtype=torch.float64).expand(len(q0), inputs.shape[1] - 1) / unit
    held = interpolate_inputs(inputs.double(), nodes=2 * split_inputs(steps, lagrangian.longest_step) + 1)
    starts = torch.cat(coordinates.push(q0.double(), v0.double() * unit), 1)
    law = list_law_arrays(energy, mass, damping)
    path = torch.from_numpy(roll_out(law, starts.numpy(), held.contiguous().numpy(), steps.numpy()))
    q, v = (each.view(*path.shape[:2], d) for each in coordinates.pull(*path.flatten(0, 1).split(d, 1)))
    v = v / unit
    q[:, 0], v[:, 0] = q0, v0  # there and back through the map is not exact
    return q, v


@torch.no_grad()
def rollout_in_torch(
    lagrangian: Lagrangian, q0: Latents, v0: Latents, inputs: Float[Tensor, "B N n_u"], *, dt_s: Steps
) -> tuple[Float[Tensor, "B N d"], Float[Tensor, "B N d"]]:
    """Roll out as `rollout` does any law, in the coordinates of the latents."""
    unit = float(lagrangian.time_unit_s)
    ready, inputs = lagrangian.prepare(), inputs.double()
    q, v, steps = q0.double(), v0.double() * unit, dt_s / unit
    positions, velocities = [q], [v]
    held = inputs[:, :, None]
    if lagrangian.integrator == "runge_kutta":
        held = interpolate_inputs(inputs, nodes=2 * split_inputs(steps, lagrangian.longest_step) + 1)
    for i in range(inputs.shape[1] - 1):
        q, v = advance_under(lagrangian, q, v, held[:, i], step=choose_step(steps, i), ready=ready)
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


def split_inputs(step: Steps, longest: float) -> int:
    """Count the equal pieces, at most ``longest``, into which a step is divided for all samples."""
    length = float(step.max()) if isinstance(step, Tensor) else step
    return max(1, math.ceil(length / longest - 1e-9))


def advance(
    lagrangian: Lagrangian, q: Latents, v: Latents, u: Inputs, *, step: Step, ready: PreparedCoefficients
) -> tuple[Latents, Latents]:
    """Advance by ``step`` internal time units under a constant input, in as many steps as needed.

    An explicit step of length h turns a frequency w into ``w (1 + (w h)^2 / 24)``. A law fitted with long
    steps would compensate for that and be wrong by as much, hence `Lagrangian.longest_step`.
    """
    pieces = split_inputs(step, lagrangian.longest_step)
    for _ in range(pieces):
        if lagrangian.integrator == "verlet":
            q, v = verlet_step(lagrangian, q, v, u, step=step / pieces, ready=ready)
        else:
            q, v = runge_kutta_step(lagrangian, q, v, (u, u, u), step=step / pieces, ready=ready)
    return q, v


def interpolate_inputs(
    inputs: Float[Tensor, "B N n_u"], *, nodes: int
) -> Float[Tensor, "B {inputs.shape[1]-1} {nodes} n_u"]:
    """Inputs at ``nodes`` evenly spaced instants of each step between frames, both ends included.

    A cubic with central slopes at the frames, and slopes of second order at both ends. A step of constant
    input would act as a delay of half a frame, and a straight line as an inertia: on a mode of 5 Hz at 60
    frames per second they shift the frequency by more than a percent.

    Source: Catmull and Rom 1974, "A class of local interpolating splines".
    """
    if inputs.shape[1] < 3:
        slope = (inputs[:, -1:] - inputs[:, :1]).expand_as(inputs)
    else:
        first = -1.5 * inputs[:, :1] + 2.0 * inputs[:, 1:2] - 0.5 * inputs[:, 2:3]
        last = 1.5 * inputs[:, -1:] - 2.0 * inputs[:, -2:-1] + 0.5 * inputs[:, -3:-2]
        slope = torch.cat([first, 0.5 * (inputs[:, 2:] - inputs[:, :-2]), last], 1)
    x = torch.linspace(0.0, 1.0, nodes, dtype=inputs.dtype)[:, None]
    start, end = inputs[:, :-1, None], inputs[:, 1:, None]
    rise, fall = slope[:, :-1, None], slope[:, 1:, None]
    away = x * x * (3.0 - 2.0 * x)
    return (1.0 - away) * start + away * end + x * (1.0 - x) * ((1.0 - x) * rise - x * fall)


def advance_under(
    lagrangian: Lagrangian,
    q: Latents,
    v: Latents,
    u: Float[Tensor, "B nodes n_u"],
    *,
    step: Step,
    ready: PreparedCoefficients,
) -> tuple[Latents, Latents]:
    """Advance as `advance` under inputs at evenly spaced instants of the step; one alone is constant."""
    if u.shape[1] == 1:
        return advance(lagrangian, q, v, u[:, 0], step=step, ready=ready)
    pieces = u.shape[1] // 2
    for i in range(pieces):
        here = (u[:, 2 * i], u[:, 2 * i + 1], u[:, 2 * i + 2])
        q, v = runge_kutta_step(lagrangian, q, v, here, step=step / pieces, ready=ready)
    return q, v


def runge_kutta_step(
    lagrangian: Lagrangian,
    q: Latents,
    v: Latents,
    u: tuple[Inputs, Inputs, Inputs],
    *,
    step: Step,
    ready: PreparedCoefficients,
) -> tuple[Latents, Latents]:
    """Make one classical Runge-Kutta step with the inputs at its start, middle and end."""

    def rate(state: Float[Tensor, "B s"], inputs: Inputs) -> Float[Tensor, "B s"]:
        x, w = state[:, : lagrangian.d], state[:, lagrangian.d :]
        return torch.cat([w, lagrangian.acceleration(x, w, inputs, ready=ready)], 1)

    state = take_runge_kutta_step(rate, torch.cat([q, v], 1), step, u)
    return state[:, : lagrangian.d], state[:, lagrangian.d :]


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
