"""Scores of a neural differential equation over the latents of an autoencoder."""

from functools import partial
from typing import Any

from lagsplat.baselines.neural_ode import LatentOde, roll_out_ode
from lagsplat.chart.chart import Chart
from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.evaluate import require_same_run, score_latent_law
from lagsplat.io.recording.recording import Recording
from lagsplat.stage1.autoencoder import Autoencoder


def evaluate_ode(
    ode: LatentOde, autoencoder: Autoencoder, chart: Chart, recording: Recording, config: EvaluateConfig
) -> dict[str, Any]:
    """Every score of the equation on the held-out part of a recording, ready for JSON.

    Raises:
        ValueError: recording, chart and autoencoder do not belong together, or the held-out part is too
            short for the protocol.
    """
    require_same_run(autoencoder, chart, recording)
    model = (autoencoder, chart, recording, config)
    return score_latent_law(*model, partial(roll_out_ode, ode), dynamics="nonlinear")
