"""What true cameras see of the simulated scene: the film from the front, and every point where it belongs."""

from pathlib import Path

import numpy as np
import pytest
from omegaconf import OmegaConf

from lagsplat.systems.config import ReleaseConfig
from lagsplat.systems.mechanism import make_mechanism
from lagsplat.systems.video import film_clips, make_space, render_true_views
from lagsplat.views.config import ArrangementConfig
from lagsplat.views.novel import NovelViews

STATES = np.array([[0.0], [0.5]])


@pytest.fixture(scope="module")
def config(repository: Path) -> ReleaseConfig:
    values = OmegaConf.load(repository / "conf" / "release" / "toy_swing.yaml")
    return OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(ReleaseConfig), values))


@pytest.fixture(scope="module")
def views(config: ReleaseConfig) -> NovelViews:
    return render_true_views(
        config, STATES, ArrangementConfig(yaw_deg=14.0, pitch_deg=5.0, columns=3, rows=1, held_out=1)
    )


def test_the_camera_in_the_middle_sees_the_film(config: ReleaseConfig, views: NovelViews) -> None:
    film = film_clips(config, [make_mechanism(config).poses(STATES)], seed=0)
    error = np.square(views.images[:, 1].astype(float) - np.asarray(film.frames)).mean()
    assert 10 * np.log10(255**2 / error) > 30  # the film has noise and a codec
    aside = np.square(views.images[:, 0].astype(float) - np.asarray(film.frames)).mean()
    assert aside > 5 * error


def test_the_target_stays_in_place_and_the_wall_moves_behind_it(
    config: ReleaseConfig, views: NovelViews
) -> None:
    space = make_space(config)
    np.testing.assert_allclose(space.pivot, [*config.scene.target, 0.0], atol=1e-9)
    wall = np.array([[*config.scene.target, config.scene.behind]])
    seen = [camera.project(wall)[0, 0] for camera in views.cameras[:3]]
    assert seen[0] < seen[1] - 2
    assert seen[2] > seen[1] + 2


def test_held_out_cameras_come_last_and_instants_differ(views: NovelViews) -> None:
    assert views.held_out.tolist() == [False, False, False, True]
    assert (views.images[0] != views.images[1]).any()
