"""The weak form of a residual, where a term is silent in the stretches that were drawn."""

import numpy as np
import pytest

from benchmarks.gap_baselines.residual import Residual, Term
from benchmarks.gap_baselines.sindy import weak_form


@pytest.mark.filterwarnings("ignore:.*axes labeled")  # of PySINDy itself
def test_a_term_that_is_zero_in_every_stretch_is_left_out() -> None:
    time = np.linspace(0.0, 4.0, 200)
    speed = np.sin(6.0 * time)
    terms = (
        Term("viscous_damping", speed),
        Term("input_gain", np.zeros_like(time), "u"),
        Term("constant_force", np.ones_like(time)),
    )
    residual = Residual(time, np.array([[0, 200]]), speed[:, None], (terms,), np.ones(1), 1.0)
    weak = weak_form(residual, 0)
    assert [term.name for term in weak.terms] == ["viscous_damping", "constant_force"]
    assert weak.features.shape[1] == 2
