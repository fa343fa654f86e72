"""How good a dynamics is: its rollout error over the training clip, the score models are chosen by."""

from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from lagsplat.chart.trajectory import Trajectory
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.stage2.objective import square_norm
from lagsplat.stage2.rollout import rollout
from lagsplat.stage2.windows import Shots, central_velocity, shots, starts_of


@dataclass(frozen=True)
class Examination:
    """Rollouts a candidate has to make, and the rms they are measured by."""

    shots: Shots
    metric: Tensor
    rms: float

    def score(self, lagrangian: Lagrangian) -> float:
        """Rms rollout error over the rms of the clip; infinite as soon as one rollout diverges."""
        q, _ = rollout(lagrangian, self.shots.q, self.shots.v, self.shots.inputs, dt_s=self.shots.steps)
        error = float(square_norm(q - self.shots.targets, self.metric).mean().sqrt()) / self.rms
        return error if np.isfinite(error) else float("inf")


def examination(trajectory: Trajectory, metric: Tensor, *, starts: int, n_states: int) -> Examination:
    """Rollouts of ``n_states`` from ``starts`` frames spread evenly over the clip.

    Initial velocities are those of training. A horizon longer than every segment is cut to
    the longest.

    Source: paper, "Fitting the dynamics": models are selected on multi-step rollout error.
    """
    longest = max(b - a for a, b in trajectory.segments)
    n_states = max(3, min(n_states, longest - 5))
    at = starts_of(trajectory, before=2, after=max(n_states, 3))
    at = at[np.unique(np.linspace(0, len(at) - 1, starts).astype(int))]
    velocity = central_velocity(trajectory, at)
    offset = torch.from_numpy(trajectory.latents - trajectory.latents.mean(0))
    rms = float(square_norm(offset, metric).mean().sqrt())
    taken = shots(trajectory, at, velocity, n_states=n_states, time_unit_s=1.0)
    return Examination(taken, metric, rms)


@dataclass
class Champion:
    """The best candidate so far; those that fail or score worse are counted and forgotten."""

    score: float = float("inf")
    state: dict[str, Tensor] = field(default_factory=dict)
    rejected: int = 0

    def consider(self, lagrangian: Lagrangian, score: float) -> None:
        """Keep the parameters if the score is the best seen."""
        if score < self.score:
            self.score = score
            self.state = {k: v.detach().clone() for k, v in lagrangian.state_dict().items()}
        else:
            self.rejected += 1

    def restore(self, lagrangian: Lagrangian) -> None:
        """Put the best parameters back."""
        lagrangian.load_state_dict(self.state)
