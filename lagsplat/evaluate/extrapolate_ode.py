"""A free neural differential equation far past its training frames."""

from typing import Any

import numpy as np

from lagsplat.baselines.neural.model import NeuralOde, carry_on
from lagsplat.chart.chart import Chart
from lagsplat.evaluate.evaluate import renderer, require_same_run
from lagsplat.evaluate.extrapolation import extrapolation, open_scene
from lagsplat.evaluate.extrapolation_config import ExtrapolationConfig
from lagsplat.evaluate.mechanical_energy import energy_along
from lagsplat.evaluate.predictor import law_predictor
from lagsplat.io.recording import Recording
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage2.lagrangian import Lagrangian


def extrapolate_ode(
    autoencoder: Autoencoder,
    chart: Chart,
    lagrangian: Lagrangian,
    ode: NeuralOde,
    recording: Recording,
    config: ExtrapolationConfig,
) -> dict[str, Any]:
    """The measures of `extrapolation` for a law without structure on the same chart.

    ``lagrangian`` gives the energy by which every model's motion is measured.

    Raises:
        ValueError: recording, chart and autoencoder do not belong together, or no clip crosses into the
        held-out frames.
    """
    require_same_run(autoencoder, chart, recording)
    crossing, known, pictures = open_scene(autoencoder, chart, recording)

    def roll_out(q0: np.ndarray, v0: np.ndarray, states: int) -> np.ndarray:
        return carry_on(ode, q0, v0, states=states, dt_s=crossing.dt_s)

    render = renderer(autoencoder, chart)
    predictor = law_predictor(roll_out, known, render, crossing, config)
    return extrapolation(predictor, crossing, known, pictures, config, energy_along(lagrangian))
