"""Decay rates and the modes of a law."""

import numpy as np
import pytest

from lagsplat.evaluate.free_motion import compare_decay, cut_free_windows
from tests.unit.evaluate.stand_ins import integrate, settings, world


def test_decay_of_the_true_law_is_read_on_both_sides():
    held, _ = world(noise=0.002)
    result = compare_decay(*cut_free_windows(held, integrate, settings()))
    assert result["encoded_per_s"] == pytest.approx(0.4, rel=0.03)
    assert result["rollout_per_s"] == pytest.approx(0.4, rel=0.03)
    assert result["value"] < 0.03
    assert result["missing"] == 0
    strongest = [row["encoded_modes"][0] for row in result["windows"]]
    assert strongest == [row["encoded"] for row in result["windows"]]


def test_a_law_that_stands_still_is_missing_and_not_perfect():
    held, _ = world()

    def still(q0, v0, inputs, steps_s):
        return np.tile(q0[:, None], (1, inputs.shape[1], 1))

    result = compare_decay(*cut_free_windows(held, still, settings()))
    assert result["value"] is None
    assert result["missing"] == len(result["windows"]) > 0
    assert result["reason"]
