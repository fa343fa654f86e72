"""Training samples cut from a latent trajectory, never across a segment."""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from lagsplat.chart.trajectory import Trajectory
from lagsplat.shapes import Inputs, Latents


@dataclass(frozen=True)
class Windows:
    """Pairs of consecutive states ``step`` internal time units apart, and the input held between them."""

    q: Latents
    v: Latents
    u: Inputs
    q_next: Latents
    v_next: Latents
    step: float

    def __len__(self) -> int:
        return self.q.shape[0]

    def pick(self, index: Int[Tensor, " b"]) -> "Windows":
        """The windows at ``index``."""
        return Windows(
            q=self.q[index],
            v=self.v[index],
            u=self.u[index],
            q_next=self.q_next[index],
            v_next=self.v_next[index],
            step=self.step,
        )


def starts_of(trajectory: Trajectory, *, before: int, after: int) -> Int[np.ndarray, " n"]:
    """Frames with ``before`` frames ahead of them and ``after`` behind within their own segment."""
    runs = [np.arange(a + before, b - after) for a, b in trajectory.segments]
    return np.concatenate([run for run in runs if len(run)] or [np.arange(0)])


def one_step_windows(trajectory: Trajectory, *, stride_frames: int, time_unit_s: float) -> Windows:
    """Windows of four samples ``stride_frames`` apart: two states with central velocities.

    The sample 1 and its velocity (2 minus 0) are the state, sample 2 and (3 minus 1) the target.

    Raises:
        ValueError: no segment is as long as a window.

    Source: paper eq. (physics_loss), facts of the published protocol.
    """
    k = stride_frames
    at = starts_of(trajectory, before=k, after=2 * k)
    if not len(at):
        longest = max((b - a for a, b in trajectory.segments), default=0)
        raise ValueError(
            f"the longest training segment has {longest} frames and a one-step window needs {3 * k + 1}: "
            "record longer clips or lower stage2.stride_frames"
        )
    step = k * trajectory.dt_s / time_unit_s
    q = torch.from_numpy(trajectory.latents)
    u = torch.from_numpy(trajectory.inputs)
    index = torch.from_numpy(at)
    return Windows(
        q=q[index],
        v=(q[index + k] - q[index - k]) / (2.0 * step),
        u=u[index],
        q_next=q[index + k],
        v_next=(q[index + 2 * k] - q[index]) / (2.0 * step),
        step=step,
    )


@dataclass(frozen=True)
class Shots:
    """Initial states, and the inputs and latents that follow them, one frame apart."""

    q: Latents
    v: Latents
    inputs: Float[Tensor, "B N n_u"]
    targets: Float[Tensor, "B N d"]


def forward_velocity(trajectory: Trajectory, at: Int[np.ndarray, " B"]) -> Latents:
    """Velocity [1/s] from a frame and the two after it: what a forecast may use."""
    q = torch.from_numpy(trajectory.latents)
    i = torch.from_numpy(at)
    return (-3.0 * q[i] + 4.0 * q[i + 1] - q[i + 2]) / (2.0 * trajectory.dt_s)


def central_velocity(trajectory: Trajectory, at: Int[np.ndarray, " B"]) -> Latents:
    """Velocity [1/s] from two frames on either side: the quieter one, for training."""
    q = torch.from_numpy(trajectory.latents)
    i = torch.from_numpy(at)
    near, far = q[i + 1] - q[i - 1], q[i + 2] - q[i - 2]
    return (8.0 * near - far) / (12.0 * trajectory.dt_s)


def shots(
    trajectory: Trajectory,
    at: Int[np.ndarray, " B"],
    velocity: Latents,
    *,
    n_states: int,
    time_unit_s: float,
) -> Shots:
    """Stretches of ``n_states`` frames from the frames ``at``, with initial velocities [1/s]."""
    rows = torch.from_numpy(at)[:, None] + torch.arange(n_states)
    q = torch.from_numpy(trajectory.latents)[rows]
    return Shots(q[:, 0], velocity * time_unit_s, torch.from_numpy(trajectory.inputs)[rows], q)
