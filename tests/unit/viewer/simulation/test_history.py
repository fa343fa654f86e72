"""The states that a recording covers."""

import numpy as np

from lagsplat.viewer.simulation.history import HistoryBuffer, measure_coverage
from tests.unit.forces.rocking import rocking


def test_training_states_are_covered_and_distant_states_are_not():
    chart = rocking(frames=900).chart
    coverage = measure_coverage(chart, beyond=0.1)
    assert len(coverage.points) == 400
    assert max(coverage.distance(q) for q in chart.latents) <= 1.0
    assert coverage.distance(np.array([1.05])) < 1.0 < coverage.distance(np.array([1.5]))


def test_the_last_rows_are_kept_in_the_memory_of_the_first():
    buffer = HistoryBuffer(dt_s=0.1, rows=7)
    parts = [np.zeros(width) for width in (2, 2, 1, 2, 2, 2, 3, 5)]
    for number in range(24):
        buffer.add(number // 10, np.full(2, float(number)), *parts[1:])
        if number == 0:
            table = buffer.table
        kept = buffer.read()
        first = max(0, number - 6)
        assert len(buffer) == len(kept) == number + 1 - first
        assert kept.q[:, 0].tolist() == list(range(first, number + 1))
        assert kept.clip.tolist() == [i // 10 for i in range(first, number + 1)]
    assert buffer.table is table
    assert table.shape == (7, 20)
