"""How coordinates are called."""

from lagsplat.chart.names import name_coordinates


def test_coordinates_count_from_one() -> None:
    assert name_coordinates(3) == ("q1", "q2", "q3")
    assert name_coordinates(0) == ()
