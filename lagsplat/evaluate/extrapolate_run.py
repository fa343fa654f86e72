"""A trained run far past its training frames: its own law, measured like every other model's."""

from typing import Any

import numpy as np

from lagsplat.chart.chart import Chart
from lagsplat.evaluate.evaluate import renderer, require_same_run
from lagsplat.evaluate.extrapolation import extrapolation, open_scene
from lagsplat.evaluate.extrapolation_config import ExtrapolationConfig
from lagsplat.evaluate.guarantee import guarantee_of
from lagsplat.evaluate.mechanical_energy import energy_along
from lagsplat.evaluate.predictor import RollOut, law_predictor
from lagsplat.io.recording import Recording
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage2.frozen import FrozenLaw, roll_out_free
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.stage2.modes import equilibrium


def extrapolate_run(
    autoencoder: Autoencoder,
    chart: Chart,
    lagrangian: Lagrangian,
    recording: Recording,
    config: ExtrapolationConfig,
) -> dict[str, Any]:
    """The measures of `extrapolation` for a run, with its ``equilibrium`` and its ``guarantee``.

    Raises:
        ValueError: recording, chart and autoencoder do not belong together, no clip crosses into the held-out
        frames, or the mass is induced by the decoder.
    """
    require_same_run(autoencoder, chart, recording)
    crossing, known, pictures = open_scene(autoencoder, chart, recording)
    render = renderer(autoencoder, chart)
    predictor = law_predictor(free_rollouts(lagrangian, crossing.dt_s), known, render, crossing, config)
    found = extrapolation(predictor, crossing, known, pictures, config, energy_along(lagrangian))
    still = lagrangian.rest.new_zeros(lagrangian.n_inputs)
    return found | {
        "clip": crossing.latents.tolist(),
        "equilibrium": equilibrium(lagrangian, still).tolist(),
        "guarantee": guarantee_of(lagrangian, chart, config.guarantee),
    }


def free_rollouts(lagrangian: Lagrangian, dt_s: float) -> RollOut:
    """Free rollouts of a learned law, one state every ``dt_s`` seconds."""
    law = FrozenLaw(lagrangian)

    def roll_out(q0: np.ndarray, v0: np.ndarray, states: int) -> np.ndarray:
        return roll_out_free(law, q0, v0, states=states, dt_s=dt_s)[0]

    return roll_out
