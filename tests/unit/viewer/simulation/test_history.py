"""The states that a recording covers."""

import numpy as np

from lagsplat.viewer.simulation.history import measure_coverage
from tests.unit.forces.rocking import rocking


def test_training_states_are_covered_and_distant_states_are_not():
    chart = rocking(frames=900).chart
    coverage = measure_coverage(chart, beyond=0.1)
    assert len(coverage.points) == 400
    assert max(coverage.distance(q) for q in chart.latents) <= 1.0
    assert coverage.distance(np.array([1.05])) < 1.0 < coverage.distance(np.array([1.5]))
