"""True answers to known forces, against statics that can be done by hand."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.config.compose import compose
from lagsplat.systems.pushable import Pushable, make_pushable
from lagsplat.systems.simulate import simulate

NONE = np.zeros(0)


def rocker(points: int = 4) -> Pushable:
    return make_pushable(None, compose("system=rainbow_rocker").release, pressure=NONE, points=points)


def arm(points: int = 3) -> Pushable:
    return make_pushable(compose("system=toy").simulation, None, pressure=np.array([0.4, 0.1]), points=points)


def metres_a_pixel() -> float:
    config = compose("system=rainbow_rocker").release
    assert config is not None
    return config.scene.view_width / config.width


def test_points_lie_on_what_is_painted() -> None:
    config = compose("system=toy").simulation
    assert config is not None
    system = arm()
    still = replace(config, camera_noise_levels=0.0, rest_frames=2, hold_frames=2, tail_frames=2, n_frames=20)
    recording, truth = simulate(still, seed=0)
    places = system.places(truth.states[:1])[0]
    frame = recording.frames[0].astype(float)
    on = np.array([frame[int(y), int(x)] for x, y in places])
    board = frame[:, :3].reshape(-1, 3).mean(0)
    assert (np.abs(on - board).max(1) > 20).mean() > 0.8, "the arm is not the colour of the board"


def test_a_force_is_balanced_by_the_weight() -> None:
    system, config = rocker(), compose("system=rainbow_rocker").release
    assert config is not None
    assert config.rocker is not None
    point = int(system.places(system.rest[None])[0, :, 0].argmax())
    force = np.array([[0.0, 0.02 * metres_a_pixel()], [0.0, 0.04 * metres_a_pixel()]])
    states = system.settled(point, force)
    lever = np.array([system.jacobian(q)[point, 1, 0] for q in states])
    weight = config.rocker.body_mass * config.gravity * config.rocker.depth * np.sin(states[:, 0])
    assert force[:, 1] * lever == pytest.approx(weight, rel=1e-6)
    assert 0 < states[0, 0] < states[1, 0]


def test_what_a_force_overcomes_has_no_equilibrium_and_keeps_none() -> None:
    gives_way = Pushable(
        rest=np.zeros(1),
        force=lambda q: -q / (1.0 + q**2),  # at most one half, at q = 1
        acceleration=lambda q, v, push: push,
        mass=lambda q: np.eye(1),
        places=lambda states: np.stack([states, 0.0 * states], axis=2),
        share=np.ones(1),
    )
    states = gives_way.settled(0, np.array([[0.4, 0.0], [0.6, 0.0], [0.4, 0.0]]))
    assert states[0, 0] == pytest.approx(0.5)
    assert np.isnan(states[1:]).all()


@pytest.mark.parametrize("build", [rocker, arm], ids=["rocker", "arm"])
def test_a_force_does_the_work_of_its_way_in_the_picture(build) -> None:
    system = build()
    q = system.rest + 0.05
    moved = system.places(q + np.stack([1e-6 * np.ones_like(q), -1e-6 * np.ones_like(q)]))
    way = (moved[0] - moved[1]) / 2e-6
    assert np.einsum("pcd,d->pc", system.jacobian(q), np.ones_like(q)) == pytest.approx(way, abs=1e-4)
    assert system.share.sum() > 0
    assert system.stiffness(system.rest) == pytest.approx(system.stiffness(system.rest).T, rel=1e-4, abs=1e-6)


def test_a_force_switched_on_swings_about_the_equilibrium() -> None:
    system = rocker()
    point = int(system.places(system.rest[None])[0, :, 0].argmax())
    force = np.array([0.0, 0.01 * metres_a_pixel()])
    settled = system.settled(point, force[None])[0, 0]
    states = system.moved(point, force, time_s=np.linspace(0.0, 30.0, 600))
    assert states[0, 0] == 0.0
    assert states[:60, 0].max() == pytest.approx(2 * settled, rel=0.1)
    assert states[-60:, 0].mean() == pytest.approx(settled, rel=0.02)


def test_filmed_recordings_have_no_truth() -> None:
    with pytest.raises(ValueError, match="recording=simulated"):
        make_pushable(None, None, pressure=NONE, points=3)
