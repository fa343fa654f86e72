"""State dependence of a mass matrix, on matrices whose answer is known."""

import numpy as np
import pytest
import torch

from lagsplat.evaluate.truth import inertia_along
from tests.unit.evaluate import tiny_run


def test_a_constant_mass_does_not_depend_on_the_state():
    law = tiny_run.lagrangian()
    said = inertia_along(law, np.random.default_rng(0).normal(size=(50, 2)))
    assert said["state_dependence"] == pytest.approx(0.0, abs=1e-9)
    assert said["span"] == pytest.approx(1.0)
    assert said["condition_max"] == pytest.approx(1.0)
    assert said["states"] == 50


def test_a_mass_that_doubles_is_told_in_any_chart(monkeypatch):
    law = tiny_run.lagrangian()
    states = np.repeat([[0.0, 0.0], [1.0, 0.0]], 10, axis=0)
    spans = []
    for stretch in (1.0, 30.0):
        chart = torch.diag(torch.tensor([1.0, stretch], dtype=torch.float64))
        monkeypatch.setattr(law, "mass", lambda q, chart=chart: (1 + q[:, :1, None]) * chart)
        said = inertia_along(law, states)
        spans.append(said["span"])
        assert said["condition_median"] == pytest.approx(stretch)
        assert said["state_dependence"] == pytest.approx(0.5 / np.sqrt(2.5))
    assert spans == pytest.approx([2.0, 2.0])
