"""Choose the weights of a baseline by how they forecast the end of the training part, kept from training."""

import copy
import math

import numpy as np
import torch
from torch import nn

from lagsplat.array_types import Images, Inputs
from lagsplat.baselines.config import BaselineValidationConfig
from lagsplat.baselines.model import Baseline
from lagsplat.integer_lists import choose_evenly
from lagsplat.io.recording.recording import Recording
from lagsplat.stage1.autoencoder import to_images

HORIZON_S = 0.5  # of the tables' short forecasts


def count_trained_frames(train: Recording, config: BaselineValidationConfig) -> int:
    """Number of leading frames of the training part that are trained on; all where nothing is withheld."""
    return train.n_frames - round(config.share * train.n_frames)


class ForecastValidation:
    """Forecasts of half a second from ``config.starts`` frames, spread over the frames from ``first`` on.

    Args:
        train: the training part of a recording.
        frames: its frames (T, H, W, 3), uint8.
        inputs: its inputs (T, samples x n_u), stacked with their delays.
        first: the first frame that is not trained on.

    Raises:
        ValueError: no clip there is half a second long.
    """

    def __init__(
        self,
        train: Recording,
        frames: torch.Tensor,
        inputs: Inputs,
        config: BaselineValidationConfig,
        *,
        first: int,
    ) -> None:
        self.frames, self.inputs, self.dt_s = frames, inputs, train.dt_s
        self.n_ahead = max(1, round(HORIZON_S / train.dt_s))
        # A neighbour on both sides tells the rate of change of the first image.
        possible = [np.arange(max(a, first) + 1, b - self.n_ahead) for a, b in train.segments]
        starts = np.concatenate(possible).astype(np.int64)
        if not len(starts):
            raise ValueError(
                f"{train.source}: the last {config.share:.0%} of the training part have no clip of "
                f"{self.n_ahead + 2} frames to forecast; raise baseline.validation.share, or set it to 0"
            )
        self.starts = torch.from_numpy(starts[choose_evenly(len(starts), config.starts)])

    def images(self, at: torch.Tensor) -> Images:
        """The images of these frames."""
        return to_images(self.frames[at])

    @torch.no_grad()
    def measure_error(self, baseline: Baseline) -> float:
        """Mean squared error of the forecast images; infinite where it is not finite."""
        s = self.starts
        rates = (self.images(s + 1) - self.images(s - 1)) / (2.0 * self.dt_s)
        z, _, v = baseline.encoder.moving(self.images(s), rates)
        windows = s[:, None] + torch.arange(self.n_ahead + 1)
        states, _ = baseline.rollout(z, v, self.inputs[windows])
        errors = [
            (baseline.decode(states[:, i]) - self.images(s + i)).square().mean()
            for i in range(1, self.n_ahead + 1)
        ]
        error = float(torch.stack(errors).mean())
        return error if math.isfinite(error) else math.inf


class WeightSelection(nn.Module):
    """The weights in training, and the best so far: a module, so that a checkpoint holds both."""

    error: torch.Tensor
    least: torch.Tensor

    def __init__(self, current: Baseline) -> None:
        super().__init__()
        self.current, self.best = current, copy.deepcopy(current)
        self.register_buffer("error", torch.tensor(math.nan, dtype=torch.float64))
        self.register_buffer("least", torch.tensor(math.inf, dtype=torch.float64))

    def update(self, error: float) -> None:
        """Keep the present weights if their validation error is the least so far."""
        self.error.fill_(error)
        if error < float(self.least):
            self.least.fill_(error)
            self.best.load_state_dict(self.current.state_dict())
