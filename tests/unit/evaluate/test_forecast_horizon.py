"""The error over time: it begins at the first state, and ends where a clip does."""

import numpy as np
import pytest

from lagsplat.evaluate.forecast import error_over_horizon
from tests.unit.evaluate.stand_ins import DT_S, settings, subject, world


def along(frames: int = 900, **changes: object) -> dict:
    held, pictures = world(frames=frames, tail=300)
    figure = settings().figure
    for key, value in ({"horizon_starts": 6} | changes).items():
        setattr(figure, key, value)
    return error_over_horizon(subject(held=held, pictures=pictures), settings(figure=figure))


def test_the_true_law_stays_at_the_floor():
    found = along(horizon_s=2.0)
    assert found["time_s"][1] == pytest.approx(DT_S)
    assert len(found["time_s"]) == round(2.0 / DT_S) == len(found["median"])
    assert max(found["high"]) < 1e-3 * max(found["hold"])
    assert not any(found["diverged"])
    assert (np.array(found["low"]) <= np.array(found["median"])).all()


def test_a_short_recording_shortens_the_horizon():
    found = along(horizon_s=500.0)
    assert len(found["time_s"]) == (900 - 40) // 2
    assert len(set(found["starts"])) > 1
