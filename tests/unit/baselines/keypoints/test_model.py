"""The parts of the key-point forecaster: places, neighbours, graph networks and paths."""

import numpy as np
import pytest
import torch

from lagsplat.baselines.keypoints.model import (
    Forecaster,
    GraphNet,
    KeyPointPath,
    KeyPoints,
    MotionNet,
    continue_path,
    draw_path,
    fit_path,
    fourier_features,
    load_forecaster,
    place_key_point_scene,
    read_forecaster_architecture,
    save_forecaster,
    wrap_angle,
)
from tests.unit.baselines.keypoints.problems import frames, settings


@pytest.fixture
def forecaster() -> Forecaster:
    config = settings()
    model = Forecaster(read_forecaster_architecture(config, height=16, width=20, frames=24), backend="torch")
    place_key_point_scene(
        model.scene,
        frames(side=20)[:, 2:18],
        sigma=0.1,
        opacity=0.5,
        rng=np.random.default_rng(0),
    )
    model.keys.gather(model.scene.place.detach(), model.scene.feature.detach(), seed=0)
    return model.eval()


def test_half_widths_are_where_they_say(forecaster: Forecaster) -> None:
    scene = forecaster.scene
    with torch.no_grad():
        scene.opacity_logit.fill_(-9.0)
        scene.opacity_logit[0], scene.color_logit[0], scene.background_logit[:] = 9.0, 9.0, -9.0
        scene.log_scale.fill_(0.0)
        place = torch.zeros(len(scene.place), 2)
        place[0] = torch.tensor([0.55, -0.45])  # 15.5 px to the right, 3.5 px down
        image = scene.draw(place, scene.angle, backend="torch")[0].sum(0)
    row, column = divmod(int(image.argmax()), 20)
    assert (row, column) == (3, 15)


def test_a_quarter_turn_swaps_the_axes(forecaster: Forecaster) -> None:
    scene = forecaster.scene
    with torch.no_grad():
        scene.log_scale[:, 0] = 1.0
        flat = scene.covariance(torch.zeros(60, 1))
        upright = scene.covariance(torch.full((60, 1), torch.pi / 2))
    torch.testing.assert_close(flat[:, [2, 0]], upright[:, [0, 2]], rtol=1e-4, atol=1e-4)


def test_nothing_moves_before_training(forecaster: Forecaster) -> None:
    moved, turned = forecaster.shift(forecaster.scene, 7.0)
    assert float(moved.abs().max().detach()) == float(turned.abs().max().detach()) == 0.0
    assert fourier_features(torch.zeros(3, 2), 6).shape == (3, 24)
    net = MotionNet(4, octaves=6, hidden=8, layers=2)
    assert net.layers[0].in_features == 4 + 24 + 12


def test_gaussians_follow_their_nearest_points_and_no_others() -> None:
    keys = KeyPoints(4, 3, 1, neighbours=1, feature_weight=0.5)
    place = torch.tensor([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0], [0.9, 0.1]])
    keys.gather(place, torch.zeros(4, 1), seed=0)
    nearest = keys.nearest(place, torch.zeros(4, 1))
    assert nearest[1] == nearest[3]
    shift = torch.eye(3)[:, :2], torch.arange(3.0)[:, None]
    moved, turned = keys.blend(nearest, shift)
    torch.testing.assert_close(moved, shift[0][nearest[:, 0]])
    torch.testing.assert_close(turned, shift[1][nearest[:, 0]])


def test_a_common_shift_of_all_points_is_everyones(forecaster: Forecaster) -> None:
    shift = torch.full((8, 2), 0.25), torch.full((8, 1), 0.1)
    moved, turned = forecaster.keys.blend(forecaster.nearest(), shift)
    torch.testing.assert_close(moved.detach(), torch.full((60, 2), 0.25))
    torch.testing.assert_close(turned.detach(), torch.full((60, 1), 0.1))


def test_the_graph_network_is_bounded_whatever_it_is_told() -> None:
    net = GraphNet(6, history=4, hidden=8, blocks=2).eval()
    with torch.no_grad():
        near, far = net(torch.zeros(1, 4, 6)), net(torch.full((1, 4, 6), 1e6))
    assert near.shape == (1, 6)
    assert torch.isfinite(far).all()
    # tanh layers: each adds at most one a block, so the head sees no more than that
    bound = sum(float(p.detach().abs().sum()) for p in net.head.parameters()) * 4 * 8
    assert float(far.abs().max()) < bound


def test_a_path_begins_at_the_last_training_frame(forecaster: Forecaster) -> None:
    path = continue_path(forecaster, 5)
    assert path.places.shape == path.turns.shape == (6, 8, 2)
    last = fit_path(forecaster, np.array([23.0]))
    np.testing.assert_allclose(path.places[0], last.places[0])
    np.testing.assert_allclose(np.linalg.norm(path.turns, axis=2), 1.0, atol=1e-5)
    assert np.isfinite(wrap_angle(torch.zeros(4)).numpy()).all()


def test_between_two_frames_points_go_straight_and_ends_are_held(forecaster: Forecaster) -> None:
    start = forecaster.keys.place.detach().numpy()
    turns = np.tile(np.array([1.0, 0.0], np.float32), (3, 8, 1))
    places = start + np.array([0.0, 0.1, 0.2], np.float32)[:, None, None]
    path = KeyPointPath(places.astype(np.float32), turns)
    images = draw_path(forecaster, path, np.array([0.5, 1.0, 2.0, 9.0, -1.0, 0.0]))
    half = KeyPointPath(path.places[[0]] + np.float32(0.05), turns[:1])
    np.testing.assert_allclose(images[0], draw_path(forecaster, half, np.zeros(1))[0], atol=1e-5)
    np.testing.assert_array_equal(images[2], images[3])
    np.testing.assert_array_equal(images[4], images[5])
    assert np.abs(images[1] - images[2]).max() > 0.01


def test_a_forecaster_comes_back_from_its_file(forecaster: Forecaster, tmp_path) -> None:
    save_forecaster(tmp_path / "model.safetensors", forecaster, {"wall_s": 1.0})
    again, header = load_forecaster(tmp_path / "model.safetensors", backend="torch")
    assert header["wall_s"] == 1.0
    np.testing.assert_array_equal(continue_path(again, 4).places, continue_path(forecaster, 4).places)
    with pytest.raises(FileNotFoundError):
        load_forecaster(tmp_path / "none.safetensors")
