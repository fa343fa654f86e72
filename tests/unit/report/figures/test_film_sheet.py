"""The sheet of a film: the crop is drawn where it is proposed, on both pictures of the whole."""

import numpy as np
import pytest

from lagsplat.report.figures.film_sheet import draw_film_sheet


@pytest.mark.parametrize("crop", [None, (10, 5, 20, 30)])
def test_the_crop_is_marked_and_shown(crop: tuple[int, int, int, int] | None) -> None:
    first = np.arange(40 * 60 * 3, dtype=np.uint32).reshape(40, 60, 3).astype(np.uint8)
    figure = draw_film_sheet(first, np.ones((4, 6)), crop, title="film.mp4")
    whole, energy, kept = figure.axes[:3]
    x, y, width, height = crop or (0, 0, 60, 40)
    np.testing.assert_array_equal(kept.images[0].get_array(), first[y : y + height, x : x + width])
    for axis in (whole, energy):
        assert [patch.get_bbox().bounds for patch in axis.patches] == ([] if crop is None else [crop])
    assert kept.get_title(loc="left") == ("no crop" if crop is None else "crop, 20 x 30 px")


def test_nothing_that_moves_is_said() -> None:
    figure = draw_film_sheet(np.zeros((8, 8, 3), np.uint8), np.zeros((8, 8)), None, title="t")
    assert figure.axes[1].get_title(loc="left") == "motion: nothing moves"
