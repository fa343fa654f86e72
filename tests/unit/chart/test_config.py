from dataclasses import asdict

import pytest

from lagsplat.chart.config import ChartConfig

GOOD = {
    "smoothing_frames": 1.0,
    "rest_frames": 10,
    "eigenvalue_floor": 1e-5,
    "visibility_frames": 8,
    "visibility_step": 1e-2,
    "refinement_steps": 1,
    "dimension_frames": 200,
    "dimension_neighbours": 10,
}


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ("smoothing_frames", -1.0),
        ("rest_frames", 0),
        ("eigenvalue_floor", 1.0),
        ("visibility_step", 0.0),
        ("refinement_steps", -1),
        ("dimension_neighbours", 2),
    ],
)
def test_a_value_outside_its_domain_is_named(key: str, value: float) -> None:
    assert asdict(ChartConfig(**GOOD)) == GOOD
    with pytest.raises(ValueError, match=rf"chart\.{key}={value}"):
        ChartConfig(**(GOOD | {key: value}))
