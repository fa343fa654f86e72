"""Ellipses of equal kinetic energy: as many as there are places, wide where the mass is small."""

import numpy as np
import pytest
from matplotlib.collections import EllipseCollection

from lagsplat.report.common.style import save_figure
from lagsplat.report.figures.equilibrium import draw_inertia


def motion(d: int, samples: int = 300) -> np.ndarray:
    t = np.linspace(0.0, 20.0, samples)
    return np.stack([np.sin((1.0 + 0.37 * i) * t + i) for i in range(d)], axis=1)


def masses(states: np.ndarray, slope: float) -> np.ndarray:
    d = states.shape[1]
    return np.eye(d) * (2.0 + slope * states[:, :1, None])


@pytest.mark.parametrize(("d", "rows"), [(1, 1), (2, 1), (3, 2), (4, 2)])
def test_a_panel_for_each_form_and_each_two_coordinates(d, rows, tmp_path):
    states = motion(d)
    forms = [("learned", masses(states, 1.0)), ("constant", masses(states, 0.0))]
    figure = draw_inertia(forms, states, title="t")
    assert len(figure.axes) == 2 * rows
    save_figure(tmp_path / "inertia.png", figure)
    assert (tmp_path / "inertia.png").stat().st_size > 5000


def test_an_ellipse_is_wide_where_the_mass_is_small():
    states = motion(2)
    figure = draw_inertia([("learned", masses(states, 1.0))], states, title="t")
    mean, own = (item for item in figure.axes[0].collections if isinstance(item, EllipseCollection))
    where = own.get_offsets()[:, 0]
    assert len(where) == 24
    wide = own.get_widths()
    assert wide[where.argmin()] > 1.2 * wide[where.argmax()]
    assert np.ptp(mean.get_widths()) == pytest.approx(0.0, abs=1e-12)


def test_an_axis_of_the_ellipse_lies_along_the_light_direction():
    states = motion(2)
    turn = np.array([[np.cos(0.5), -np.sin(0.5)], [np.sin(0.5), np.cos(0.5)]])
    matrix = turn @ np.diag([0.25, 4.0]) @ turn.T  # light along 0.5 rad: four times as wide there
    figure = draw_inertia([("learned", np.tile(matrix, (len(states), 1, 1)))], states, title="t")
    own = [item for item in figure.axes[0].collections if isinstance(item, EllipseCollection)][-1]
    assert own.get_widths()[0] == pytest.approx(4.0 * own.get_heights()[0])
    assert own.get_angles()[0] % 180.0 == pytest.approx(np.degrees(0.5))


def test_matrices_of_other_states_are_refused():
    states = motion(2)
    with pytest.raises(ValueError, match=r"'learned': 299.* a trajectory of 300"):
        draw_inertia([("learned", masses(states, 1.0)[1:])], states, title="t")
