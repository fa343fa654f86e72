"""The nine panels: what is pushed, what answers, and how it is drawn."""

import numpy as np
import pytest

from lagsplat.config.compose import compose
from lagsplat.report.figures.forces import compute_force_panels, draw_forces
from tests.unit.forces.rocking import hanging, rocking

SETTINGS = compose().forces


def test_a_rocker_shows_levers_directions_and_background():
    point = rocking()
    shown = compute_force_panels(point, SETTINGS, hanging=False)
    assert [panel.name for panel in shown.panels] == ["lever"] * 3 + ["direction"] * 3 + ["background"] * 3
    shifts = [panel.shift[0] for panel in shown.panels]
    assert 0 > shifts[0] > shifts[1] > shifts[2]
    assert shifts[3] == pytest.approx(SETTINGS.response * point.visited_radius, rel=1e-2)
    assert max(abs(shift) for shift in shifts[6:]) < 1e-3 * shifts[3]
    sizes = {round(float(np.linalg.norm(panel.arrows[0, 1])), 9) for panel in shown.panels}
    assert len(sizes) == 1, "one force throughout"
    figure = draw_forces(shown, title="t")
    assert [axis.get_title(loc="left")[:4] for axis in figure.axes] == [f"({x}) " for x in "abcdefghi"]


def test_the_arrow_starts_where_the_matter_has_come_to():
    panel = compute_force_panels(rocking(), SETTINGS, hanging=False).panels[3]
    turned = 0.1 * panel.shift[0]
    foot = panel.arrows[0, 0]
    assert panel.moved_px == pytest.approx(turned * np.hypot(foot[0] - 16, foot[1] - 19), rel=0.35)


def test_an_arm_is_bent_stretched_and_pulled_apart():
    shown = compute_force_panels(hanging(), SETTINGS, hanging=True)
    shift = np.stack([panel.shift for panel in shown.panels])
    assert len(shift) == 9
    assert shift[:4, 0] * [1, -1, 1, -1] == pytest.approx(-np.abs(shift[:4, 0]))
    assert abs(shift[4:8, 0]).max() < 0.05 * abs(shift[4:8, 1]).min(), "along the axis nothing bends"
    assert (shift[4:8:2, 1] > 0).all(), "outwards"
    assert (shift[5:8:2, 1] < 0).all(), "inwards"
    assert len(shown.panels[8].arrows) == 2
    assert 0 < shift[8, 0] < shift[1, 0]
