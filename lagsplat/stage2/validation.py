"""Rollouts over the training clip, by which laws are scored and compared."""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float64, Int
from scipy.special import stdtr
from torch import Tensor

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2 import objective
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.stage2.rollout import (
    ShootingTargets,
    cut_shooting_targets,
    list_starts,
    rollout,
)

CHANCE = 0.05  # that equally good laws are called different
INDIFFERENT_RATIO = 1.1  # of two scores, up to which a difference does not matter, however certain it is
LARGEST_RATIO = 2.0  # beyond which it does: rollouts went astray; set by hand, the simulated bag in view


@dataclass(frozen=True)
class ForecastErrors:
    """Mean square error of each rollout of a law over that of a forecast that is always the mean state.

    Args:
        each: one number a rollout, infinite where it diverged.
        distinct: how many of the rollouts do not overlap; neighbours do.
        starts: frame at which each begins.
    """

    each: Float64[np.ndarray, " B"]
    distinct: int
    starts: Int[np.ndarray, " B"]

    @property
    def score(self) -> float:
        """Root of the mean; infinite if any rollout diverged."""
        return float(np.sqrt(self.each.mean()))

    def of_frames(self, first: int, end: int) -> "ForecastErrors":
        """Errors of the rollouts that begin at the frames ``first`` to ``end``; of all if none does."""
        inside = (self.starts >= first) & (self.starts < end)
        if not inside.any():
            return self
        distinct = max(1, round(self.distinct * inside.mean()))
        return ForecastErrors(self.each[inside], distinct, self.starts[inside])

    @classmethod
    def join(cls, parts: Sequence["ForecastErrors"]) -> "ForecastErrors":
        """Errors of rollouts that follow one another."""
        each, starts = (np.concatenate([vars(part)[name] for part in parts]) for name in ("each", "starts"))
        return cls(each, sum(part.distinct for part in parts), starts)

    def is_worse_than(self, other: "ForecastErrors") -> bool:
        """Whether these errors are larger than those of another law on the same windows, and not by chance.

        They are if the score is twice as large, or if it is a tenth larger and a one-sided t-test of the
        differences of logarithms says so, one number for each group of overlapping rollouts: errors of large
        and small motions then count alike. Of fewer than two groups the scores decide alone.
        """
        if not self.score > INDIFFERENT_RATIO * other.score:
            return False
        if not self.score <= LARGEST_RATIO * other.score or self.distinct < 2:
            return True
        ratios = np.log(self.each + 1e-300) - np.log(other.each + 1e-300)
        groups = [part.mean() for part in np.array_split(ratios, self.distinct)]
        error = float(np.std(groups, ddof=1)) / math.sqrt(len(groups))
        return bool(stdtr(len(groups) - 1, -float(np.mean(groups)) / max(error, 1e-300)) < CHANCE)

    def is_as_good_as(self, other: "ForecastErrors") -> bool:
        """Whether these errors are at most a tenth larger, and are so, too, where small motions count alike.

        The second is the geometric mean: the score is that of the largest motions. With a smaller score they
        are as good in any case: then rollouts of the other law go astray.
        """
        if self.score < other.score:
            return True
        typical = np.exp(0.5 * np.mean(np.log(self.each + 1e-300) - np.log(other.each + 1e-300)))
        return self.score <= INDIFFERENT_RATIO * other.score and bool(typical <= INDIFFERENT_RATIO)


@dataclass(frozen=True)
class ValidationTask:
    """The rollouts that score a law, and the mean square of the clip that normalises their errors."""

    shots: ShootingTargets
    metric: Tensor
    mean_square: float
    distinct: int
    starts: Int[np.ndarray, " B"]

    def measure(self, lagrangian: Lagrangian) -> ForecastErrors:
        """Roll a law out and measure what it misses."""
        shots = self.shots
        q, _ = rollout(lagrangian, shots.q, shots.v, shots.inputs, dt_s=shots.steps)
        errors = objective.square_norm(q - shots.targets, self.metric).mean(1).numpy() / self.mean_square
        return ForecastErrors(np.where(np.isfinite(errors), errors, np.inf), self.distinct, self.starts)


def draw_validation_task(
    trajectory: EncodedTrajectory, metric: Float[Tensor, "d d"], *, starts: int, n_states: int
) -> ValidationTask:
    """Make a task of rollouts of ``n_states`` from ``starts`` frames spread evenly over the clip.

    A horizon longer than every segment is cut to the longest one.

    Source: paper, "Fitting the dynamics": models are selected on multi-step rollout error.
    """
    longest = max(b - a for a, b in trajectory.segments)
    n_states = max(3, min(n_states, longest - 5))
    at = list_starts(trajectory, before=2, after=max(n_states, 3))
    at = at[np.unique(np.linspace(0, len(at) - 1, starts).astype(int))]
    offset = torch.from_numpy(trajectory.latents - trajectory.latents.mean(0))
    mean_square = float(objective.square_norm(offset, metric).mean())
    targets = cut_shooting_targets(trajectory, at, n_states=n_states, time_unit_s=1.0)
    distinct = min(len(at), max(1, sum(b - a for a, b in trajectory.segments) // n_states))
    return ValidationTask(targets, metric, mean_square, distinct, at)
