"""Windows of a trajectory, from whose starts a law is rolled out."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Int
from torch import Tensor

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2.rollout import interpolate_inputs, split_inputs

STRETCHES = 8  # into which the used part of a long recording is divided, set by hand


@dataclass(frozen=True)
class Windows:
    """Windows of ``n`` steps of a trajectory; the next one follows the ``linked`` ones without a gap."""

    targets: Float[Tensor, "K m d"]
    inputs: Float[Tensor, "K n nodes n_u"]
    steps: Float[Tensor, "K n"]  # in internal time units
    frames: Int[np.ndarray, " K"]  # at which they begin
    linked: Bool[np.ndarray, " K"]

    @property
    def n(self) -> int:
        """Steps of a window."""
        return self.steps.shape[1]


def choose_stretches(segments: Sequence[tuple[int, int]], *, frames: int) -> list[tuple[int, int]]:
    """Choose at most about ``frames`` frames of the segments, in long stretches that are spread evenly."""
    total = sum(stop - start for start, stop in segments)
    if total <= frames:
        return list(segments)
    length = max(2, frames // STRETCHES)
    chosen = []
    for start, stop in segments:
        count = max(1, round(STRETCHES * (stop - start) / total))
        size = min(length, (stop - start) // count)
        for first in np.linspace(start, stop - size, count).astype(int):
            chosen.append((int(first), int(first) + size))
    return chosen


def cut_windows(
    trajectory: EncodedTrajectory,
    segments: Sequence[tuple[int, int]],
    *,
    n: int,
    time_unit_s: float,
    longest_step: float,
) -> Windows:
    """Cut windows of ``n`` steps, one after another, from parts of a trajectory.

    Raises:
        ValueError: no part is as long as a window.
    """
    frames, linked = [], []
    for start, stop in segments:
        count = (stop - 1 - start) // n
        frames += [start + k * n for k in range(count)]
        linked += [k + 1 < count for k in range(count)]
    if not frames:
        longest = max((stop - start for start, stop in segments), default=0)
        raise ValueError(
            f"the longest training segment has {longest} frames and a window of the fit needs {n + 1}: "
            "record longer clips or lower stage2.likelihood.periods"
        )
    at = np.array(frames)
    steps = np.diff(trajectory.time_s[at[:, None] + np.arange(n + 1)], axis=1) / time_unit_s
    nodes = 2 * split_inputs(float(steps.max()), longest_step) + 1
    inputs = torch.zeros(len(trajectory.inputs), nodes, trajectory.inputs.shape[1], dtype=torch.float64)
    for start, stop in trajectory.segments:
        series = torch.from_numpy(trajectory.inputs[None, start:stop])
        inputs[start : stop - 1] = interpolate_inputs(series, nodes=nodes)[0]
    return Windows(
        targets=torch.from_numpy(trajectory.latents[at[:, None] + np.arange(n + 1)]),
        inputs=inputs[torch.from_numpy(at[:, None] + np.arange(n))],
        steps=torch.from_numpy(steps),
        frames=at,
        linked=np.array(linked),
    )
