"""Matter in space is found in films from several cameras, and moves in depth as it was painted."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pytest
import torch

from lagsplat.matter.config import MatterConfig
from lagsplat.matter.field import MatterField, MatterReport
from lagsplat.matter.fit import fit_matter
from lagsplat.matter.scene import MatterScene
from tests.unit.matter.space_films import HEIGHT, TILTED, WIDTH, Plate, differentiate, photograph

CONFIG = MatterConfig(frames=100, latent_degree=2, bending=0, bodies=1)
ASIDE = ((-15.0, -5.0), (12.0, 8.0))
STATES = np.sqrt(2.0) * np.sin(np.linspace(0.0, 40.0, 100))[:, None]


def fit(
    plate: Plate, angles: Sequence[tuple[float, float]] = ASIDE
) -> tuple[MatterField, MatterReport, MatterScene]:
    frames, scene = photograph(plate, STATES, angles)
    return *fit_matter(frames, STATES, CONFIG, scene=scene), scene


@pytest.fixture(scope="module")
def seen_from_one_side() -> tuple[MatterField, MatterScene]:
    """The tilted plate as one camera sees it."""
    matter, _, scene = fit(TILTED, ())
    return matter, scene


def measure(matter: MatterField, plate: Plate, scene: MatterScene) -> tuple[np.ndarray, np.ndarray]:
    """Angle between found and true motions [deg], and errors of the places (T, P, 3) [px]."""
    points = matter.points.numpy()
    found = matter.jacobian(torch.zeros(1).double()).numpy()[..., 0]
    true = differentiate(plate, points)
    cosine = (found * true).sum(1) / np.linalg.norm(found, axis=1) / np.linalg.norm(true, axis=1)
    places = matter.carry(torch.from_numpy(STATES)).numpy()
    return np.degrees(np.arccos(cosine)), places - np.stack([plate.carry(points, q) for q in STATES])


def test_a_plate_that_turns_out_of_the_picture_is_found_with_its_depth() -> None:
    matter, report, scene = fit(TILTED)
    angles, errors = measure(matter, TILTED, scene)
    assert np.median(angles) < 0.5
    assert np.quantile(angles, 0.9) < 1.0
    assert np.abs(errors).max() < 0.1
    assert len(matter.points) > 0.75 * TILTED.count_pixels(scene.camera)
    assert TILTED.meets(scene.camera, matter.points.numpy()).all()
    assert not report.warnings


def test_perspective_alone_tells_of_depth_if_there_is_one_camera(
    seen_from_one_side: tuple[MatterField, MatterScene],
) -> None:
    matter, scene = seen_from_one_side
    angles, errors = measure(matter, TILTED, scene)
    assert np.median(angles) < 3.0
    assert np.sqrt(np.mean(errors**2)) < 0.3


def test_motion_in_the_picture_has_no_depth() -> None:
    plate = Plate(lambda q: (np.array([0.0, 0.0, 0.15 * q[0]]), np.array([3.0 * q[0], 0.0, 0.0])))
    matter, _, _ = fit(plate)
    along = matter.jacobian(torch.zeros(1).double())[..., 0].square().mean(0).sqrt()
    assert along[2] < 0.03 * along[:2].norm()


def test_pixels_without_depth_are_no_matter() -> None:
    frames, scene = photograph(TILTED, STATES, ())
    holes = scene.depth.copy()
    holes[:, 22:25] = np.nan
    matter, _ = fit_matter(frames, STATES, CONFIG, scene=replace(scene, depth=holes))
    x = matter.points[:, 0] / matter.points[:, 2] * scene.lens[0] + scene.lens[2]
    assert len(matter.points)
    assert torch.isfinite(matter.points).all()
    assert not ((x > 22.0) & (x < 25.0)).any()
    with pytest.raises(ValueError, match="only 0 pixels change their colour in most frames and have a depth"):
        fit_matter(frames, STATES, CONFIG, scene=replace(scene, depth=np.full_like(holes, np.nan)))


def test_what_is_unknown_of_novel_views_does_not_count(
    seen_from_one_side: tuple[MatterField, MatterScene],
) -> None:
    frames, scene = photograph(TILTED, STATES, ASIDE)
    against = photograph(TILTED, -STATES, ASIDE)[1].views
    assert against is not None
    unknown = replace(against, cover=np.zeros(against.images.shape[:4], np.uint8))
    alone, _ = seen_from_one_side
    blind, _ = fit_matter(frames, STATES, CONFIG, scene=replace(scene, views=unknown))
    states = torch.from_numpy(STATES)
    torch.testing.assert_close(blind.carry(states), alone.carry(states), atol=1e-3, rtol=0.0)


def test_a_scene_of_another_film_is_refused() -> None:
    frames, scene = photograph(TILTED, STATES, ASIDE)
    with pytest.raises(ValueError, match="views of 100 instants for 90 frames"):
        fit_matter(frames[:90], STATES[:90], CONFIG, scene=scene)
    with pytest.raises(ValueError, match=rf"a depth of \({HEIGHT}, {WIDTH}\) pixels for frames of"):
        fit_matter(frames[:, 1:], STATES, CONFIG, scene=scene)
