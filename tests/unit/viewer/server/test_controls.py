"""Bounds of sliders, in numbers that are short to read."""

import pytest

from lagsplat.viewer.server.controls import LEAST_INPUT_RANGE, bound_input


@pytest.mark.parametrize(
    ("recorded", "shown"),
    [
        ((-0.00281, 0.853737), (-0.002, 0.853, 0.001)),
        ((0.0, 1.0), (0.0, 1.0, 0.01)),
        ((-0.3, 0.3), (-0.3, 0.3, 0.001)),
        ((1234.56, 8765.43), (1240.0, 8760.0, 10.0)),
        ((2.0, 2.0), (2.0, 2.0 + LEAST_INPUT_RANGE, LEAST_INPUT_RANGE)),
    ],
)
def test_a_slider_stays_within_what_was_recorded(recorded: tuple[float, float], shown: tuple) -> None:
    low, high, step = bound_input(*recorded)
    assert (low, high, step) == pytest.approx(shown, rel=1e-12)
    assert len(f"{low}") <= 6
