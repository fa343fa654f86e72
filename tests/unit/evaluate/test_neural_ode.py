"""A neural differential equation scored on a run in miniature."""

import json
from dataclasses import replace

import numpy as np
import pytest

from lagsplat.baselines.neural_ode import STRUCTURES
from lagsplat.evaluate.neural_ode import evaluate_ode
from tests.unit.evaluate import tiny_run
from tests.unit.evaluate.stand_ins import settings


@pytest.mark.parametrize("structure", list(STRUCTURES))
def test_it_is_scored_from_the_same_starts_as_every_other_law(structure: str) -> None:
    film, model = tiny_run.recording(), tiny_run.autoencoder()
    chart, config = tiny_run.chart(model, film), settings(starts=6, floor_frames=40)
    sizes = {"hidden": 8, "layers": 1, "method": "midpoint", "time_unit_s": 0.2}
    ode = STRUCTURES[structure](chart.d, film.inputs.shape[1], **sizes)
    scores = evaluate_ode(ode, model, chart, film, config)
    assert json.loads(json.dumps(scores, allow_nan=False)) == scores
    assert scores["dynamics"] == "nonlinear"
    assert len(scores["forecast"]["starts"]) == 6
    moved = replace(chart, latents=np.asarray(chart.latents)[::-1].copy())
    with pytest.raises(ValueError, match="whitened units from the chart's latents"):
        evaluate_ode(ode, model, moved, film, config)
