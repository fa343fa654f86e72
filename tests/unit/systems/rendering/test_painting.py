from dataclasses import replace

import numpy as np
import pytest

from lagsplat.systems.arm import build_arm
from lagsplat.systems.rendering.painting import paint_arm, paint_board


def picture(config, states, *, pixels=None, seed=0):
    size = pixels or config.width
    config = replace(config, height=size, width=size)
    board = paint_board(config, generator=np.random.default_rng(seed))
    return paint_arm(build_arm(config.arm), states, config, board), board


@pytest.mark.parametrize("coordinate", range(4))
def test_pictures_move_without_steps(load, coordinate):
    config = load("krauss_2seg")
    states = np.tile([0.2, 0.1, -0.3, 0.1], (401, 1))
    states[:, coordinate] += np.linspace(-0.05, 0.05, 401)
    images = picture(config, states)[0]
    speed = np.sqrt(np.sum(np.diff(images.astype(float), axis=0) ** 2, axis=(1, 2, 3)))
    assert speed.min() > 0.7 * speed.max()


def test_a_straight_arm_moves_without_steps(load):
    states = np.zeros((401, 2))
    states[:, 0] = np.linspace(-0.03, 0.03, 401)
    images = picture(load("krauss_1seg"), states)[0].astype(float)
    speed = np.sqrt(np.sum(np.diff(images, axis=0) ** 2, axis=(1, 2, 3)))
    assert speed.min() > 0.7 * speed.max()


def test_one_scene_at_every_resolution(load):
    states = np.array([[0.4, 0.1, -0.6, 0.2]])
    coarse = picture(load("krauss_2seg"), states)[0][0]
    fine = picture(load("krauss_2seg"), states, pixels=128)[0][0]
    reduced = fine.reshape(32, 4, 32, 4, 3).mean(axis=(1, 3))
    below_clamp = slice(4, None)
    assert np.abs(coarse - reduced)[below_clamp].max() < 0.03
    assert np.abs(coarse - reduced).mean() < 0.002


def test_the_arm_hangs_straight_stretches_down_and_bends_right(load):
    config = load("krauss_1seg")
    states = np.array([[0.0, 0.0], [0.0, 0.25], [0.6, 0.0], [-0.6, 0.0]])
    images, board = picture(config, states)
    shown = np.abs(images - board).max(axis=-1) > 0.05
    rows = [np.flatnonzero(mask.any(axis=1)).max() for mask in shown]
    columns = [np.average(np.arange(32) + 0.5, weights=mask.sum(axis=0)) for mask in shown]
    scale = config.width / config.view_width
    assert rows[1] - rows[0] == pytest.approx(0.25 * config.arm.length[0] * scale, abs=1)
    assert columns[0] == pytest.approx(16, abs=0.3)
    assert columns[2] > 17.2
    assert columns[2] + columns[3] == pytest.approx(32, abs=0.5)
    width = shown[0, 10].sum()
    assert width == pytest.approx(2 * config.arm.half_width * scale, abs=1.5)


def test_colors_stay_in_range_and_the_board_follows_its_seed(load):
    config = load("toy")
    images, board = picture(config, np.array([[0.5, 0.2]]))
    assert images.dtype == np.float32
    assert images.min() >= 0
    assert images.max() <= 1
    assert 0.02 < board.std() < 0.2
    assert not np.array_equal(board, picture(config, np.zeros((1, 2)), seed=1)[1])
