"""The recording of a mechanism that is let go: what is seen is where the bodies are."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from lagsplat.config.compose import compose
from lagsplat.config.schema import options
from lagsplat.systems.config import PushConfig, ReleaseClipConfig, ReleaseConfig
from lagsplat.systems.mechanism import make_mechanism
from lagsplat.systems.release import simulate_release
from lagsplat.systems.rendering.painting import DrawnBody, paint_bodies
from lagsplat.systems.rendering.textures import SHAPES
from lagsplat.systems.rendering.workshop import WALLS, draw_wall
from lagsplat.systems.simulate import resize_simulation, simulate_system
from lagsplat.systems.truth import load_truth, save_truth
from lagsplat.systems.video import film_clips, make_camera


def short(name: str, n_frames: int = 6, **changes: object) -> ReleaseConfig:
    config = compose(f"system={name}").release
    assert config is not None
    clips = [replace(clip, n_frames=n_frames) for clip in config.clips]
    return replace(config, **{"clips": clips, **changes})


@pytest.mark.parametrize("name", options("release"))
def test_every_release_gives_a_recording_and_its_truth(name: str, tmp_path) -> None:
    config = short(name)
    recording, truth = simulate_system(None, config, seed=0)
    n = 6 * len(config.clips)
    assert recording.frames.shape == (n, config.height, config.width, 3)
    assert len(recording.segments) == len(config.clips)
    assert recording.dt_s == pytest.approx(config.dt_s)
    assert truth.states.shape == (n, len(truth.coordinates))
    assert truth.decay_rates_per_s.min() > 0
    assert recording.frames.std(axis=0).max() > 5, "something moves"
    save_truth(tmp_path / "truth.safetensors", truth, {})
    again, _ = load_truth(tmp_path / "truth.safetensors")
    assert again.coordinates == truth.coordinates
    np.testing.assert_array_equal(again.states, truth.states)


def test_one_seed_is_one_recording_and_another_differs_in_its_noise_alone() -> None:
    config = short("rainbow_rocker")
    (film, truth), (again, _), (other, moved) = (simulate_release(config, seed=seed) for seed in (0, 0, 1))
    assert film.meta["sha256"] == again.meta["sha256"] != other.meta["sha256"]
    np.testing.assert_array_equal(truth.states, moved.states)
    difference = film.frames.astype(float) - other.frames
    assert 0.1 < difference.std() < 3.0, "noise of sensor and codec, averaged over the film's pixels"


def test_a_larger_picture_shows_the_same_motion() -> None:
    config = short("double_pendulum")
    large = replace(config, height=2 * config.height, width=2 * config.width)
    (film, truth), (fine, same) = simulate_release(config, seed=0), simulate_release(large, seed=0)
    np.testing.assert_array_equal(truth.states, same.states)
    small = np.array(
        [cv2.resize(frame, film.frames.shape[2:0:-1], interpolation=cv2.INTER_AREA) for frame in fine.frames]
    )
    assert np.abs(small.astype(float) - film.frames).mean() < 2.5


def test_the_ball_is_where_the_truth_says_to_a_hundredth_of_its_path() -> None:
    config = short("pendulum", n_frames=40)
    camera = make_camera(config)
    sprite = SHAPES["bob"](config.bodies[0].size_m, camera.focal[0] / config.scene.distance)
    black = np.zeros((camera.height, camera.width, 3), np.float32)
    angles = np.linspace(-0.4, 0.4, 9)[:, None]
    mechanism = make_mechanism(config)
    poses = mechanism.poses(angles)
    columns = []
    for pose in poses:
        picture = paint_bodies(black, [DrawnBody(sprite, 0.0, 1)], pose, camera)
        ball = picture[:, :, 0] - picture[:, :, 1]  # the rod is grey
        ball = np.where(ball > 0.2, ball, 0)
        columns.append((ball.sum(0) @ (np.arange(camera.width) + 0.5)) / ball.sum())
    length = config.bodies[0].size_m[0]
    points = np.array([[length * np.sin(a), length * np.cos(a), 0.0] for a in angles[:, 0]])
    expected = camera.project(points)[:, 0]
    offsets = np.array(columns) - expected
    assert np.ptp(offsets) < 0.6, "pixels of the film, of which four make one of the recording"


def test_a_camera_from_the_side_sees_the_flank() -> None:
    config = short("rainbow_rocker", n_frames=3)
    poses = [make_mechanism(config).poses(np.zeros((3, 1)))]
    aside = replace(config, scene=replace(config.scene, yaw_deg=config.scene.yaw_deg + 35.0))
    front, side = (film_clips(each, poses, seed=0).frames[0].astype(float) for each in (config, aside))
    assert np.abs(front - side).mean() > 5
    flat = replace(aside, bodies=[replace(config.bodies[0], thickness_m=0.0, layers=1)])
    flat_side = film_clips(flat, poses, seed=0).frames[0].astype(float)
    assert np.abs(side - flat_side).mean() > 1


@pytest.mark.filterwarnings("ignore:.*the film jumps")  # from stillness, any motion is sudden
def test_a_push_moves_what_would_have_hung_still() -> None:
    config = short("pendulum", n_frames=30)
    still = replace(config, clips=[ReleaseClipConfig(30, [0.0], [0.0])])
    push = PushConfig(clip=0, start_s=0.1, stop_s=0.3, body=0, at_m=[0.0, 0.44], force_n=[2.0, 0.0])
    _, calm = simulate_release(still, seed=0)
    _, pushed = simulate_release(replace(still, pushes=[push]), seed=0)
    assert np.abs(calm.states).max() < 1e-9
    assert pushed.states[-1, 0] > 0.02
    assert not calm.forces.any()
    assert pushed.forces.max() == pytest.approx(2.0 * 0.44, rel=0.01), "force times lever at its height"


def test_a_codec_that_cannot_be_written_is_named() -> None:
    config = short("rainbow_rocker")
    with pytest.raises(ValueError, match=r"OpenCV cannot write 'HFYU' into \.mp4"):
        simulate_release(replace(config, scene=replace(config.scene, codec="HFYU")), seed=0)


def test_an_unknown_wall_is_refused() -> None:
    with pytest.raises(ValueError, match="no wall 'moonbase'; choose one of bricks, pegboard"):
        draw_wall("moonbase")


@pytest.mark.parametrize("name", WALLS)
def test_a_wall_has_texture_everywhere_and_clips_nowhere(name: str) -> None:
    wall = draw_wall(name)
    assert wall.shape == (600, 900, 3)
    assert wall.min() >= 0.0
    assert wall.max() <= 1.0
    patches = wall.reshape(6, 100, 9, 100, 3).std(axis=(1, 3))
    assert patches.min() > 0.01, "a camera of 8 bits sees something in every patch"
    with pytest.raises(ValueError, match="read-only"):
        wall[0, 0] = 0.0


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"rocker": None, "linkage": None}, "either a linkage or a rocker"),
        ({"bodies": []}, "one look for each"),
        ({"clips": []}, "nothing to record"),
        ({"clips": [ReleaseClipConfig(2, [0.0], [0.0])]}, "at least 3 frames"),
        ({"clips": [ReleaseClipConfig(9, [0.0, 1.0], [0.0])]}, "1 values of state"),
        ({"pushes": [PushConfig(0, 1.0, 0.5, 0, [0.0, 0.0], [1.0, 0.0])]}, "ends before it begins"),
        ({"dt_s": 0.0}, "must be positive"),
        ({"height": 4}, "height=4 must be at least 8"),
    ],
)
def test_values_that_cannot_be_filmed_are_refused(changes: dict[str, object], message: str) -> None:
    with pytest.raises(ValueError, match=message):
        short("pendulum", **changes)


def test_nothing_to_stand_in_is_an_error() -> None:
    with pytest.raises(ValueError, match="neither a simulation nor a release"):
        simulate_system(None, None, seed=0)


def test_a_finer_recording_is_of_the_same_film() -> None:
    config = short("rainbow_rocker")
    _, finer = resize_simulation(None, config, height=2 * config.height, width=2 * config.width)
    assert finer is not None
    assert finer.scene.film_scale * finer.height == config.scene.film_scale * config.height
    (film, _), (fine, _) = simulate_release(config, seed=0), simulate_release(finer, seed=0)
    blocks = fine.frames.reshape(6, config.height, 2, config.width, 2, 3).mean(axis=(2, 4))
    assert np.abs(blocks - film.frames).max() <= 2, "the same pixels of the same film, averaged"
