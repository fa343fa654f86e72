"""The moving picture of a push: the force acts, the answer follows, and every frame is in the file."""

from pathlib import Path

import numpy as np
import pytest
from PIL import Image

from lagsplat.report.figures.push_animation import HOLD_S, compute_push_view, save_push_animation
from tests.unit.forces.rocking import rocking


def test_the_pushed_matter_gives_way_and_swings_back(tmp_path: Path) -> None:
    point = rocking()
    film = np.zeros((40, point.height, point.width, 3), dtype=np.uint8)
    view = compute_push_view(point, film)
    assert len(view.film) == len(view.pushed) == len(view.moved_px) <= 40
    assert len(view.feet) == round(HOLD_S / point.chart.dt_s) or len(view.feet) == len(view.moved_px)
    assert view.moved_px[0] == 0.0
    assert view.moved_px.max() > 0.5
    way = (view.feet[-1] - view.feet[0]) @ view.direction
    assert way == pytest.approx(view.moved_px[len(view.feet) - 1])
    save_push_animation(tmp_path / "push.gif", view, title="t")
    with Image.open(tmp_path / "push.gif") as written:
        assert written.n_frames == len(view.pushed)
        assert written.info["duration"] == 10 * round(100 * view.dt_s)
        assert written.info["loop"] == 0
