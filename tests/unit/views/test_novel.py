"""Novel views keep what they are told and refuse what does not fit; the coordinates of space are pixels."""

from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest

from lagsplat.views.camera import ViewSpace, arrange_cameras, look_at
from lagsplat.views.config import ArrangementConfig, SharpConfig, SupervisionConfig, ViewsConfig
from lagsplat.views.novel import NovelViews, load_views, require_views, save_views

ARRANGEMENT = ArrangementConfig(yaw_deg=12.0, pitch_deg=4.0, columns=3, rows=1, held_out=2)


def space() -> ViewSpace:
    camera = look_at(
        np.array([0.1, 0.2, 0.0]),
        distance=2.0,
        yaw_deg=10.0,
        pitch_deg=5.0,
        view_width=1.0,
        height=6,
        width=8,
    )
    return ViewSpace(camera, 2.0)


def views(instants: int = 3, *, cover: bool = False) -> NovelViews:
    cameras, names, held_out = arrange_cameras(space(), ARRANGEMENT)
    rng = np.random.default_rng(0)
    images = rng.integers(0, 255, (instants, len(cameras), 6, 8, 3), dtype=np.uint8)
    known = rng.integers(0, 255, images.shape[:4], dtype=np.uint8) if cover else None
    return NovelViews(images, known, tuple(cameras), tuple(names), np.array(held_out), space())


@pytest.mark.parametrize("cover", [False, True])
def test_views_come_back_as_they_were(tmp_path: Path, cover: bool) -> None:
    kept = views(cover=cover)
    save_views(tmp_path / "views.safetensors", kept, {})
    back = load_views(tmp_path / "views.safetensors")
    np.testing.assert_array_equal(back.images, kept.images)
    assert (back.cover is None) == (kept.cover is None)
    if kept.cover is not None:
        np.testing.assert_array_equal(back.cover, kept.cover)
    for one, other in zip(back.cameras, kept.cameras, strict=True):
        np.testing.assert_array_equal(one.rotation, other.rotation)
        np.testing.assert_array_equal(one.position, other.position)
        assert (one.focal, one.middle, one.height) == (other.focal, other.middle, other.height)
    assert back.names == kept.names
    assert back.seen == (0, 1, 2)
    assert back.space.unit == kept.space.unit


@pytest.mark.parametrize(
    ("change", "message"),
    [
        ({"names": ("a",)}, "5 images an instant, but 5 cameras, 1 names"),
        ({"images": np.zeros((3, 5, 7, 8, 3), np.uint8)}, "is of 6 x 8 pixels and its images of 7 x 8"),
        ({"cover": np.zeros((3, 5, 6, 7), np.uint8)}, r"cover of shape \(3, 5, 6, 7\)"),
        ({"held_out": np.ones(5, bool)}, "all 5 cameras are held out"),
    ],
)
def test_parts_that_do_not_fit_are_refused(change: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        replace(views(), **change)


def test_views_of_another_recording_are_refused() -> None:
    require_views(views(3), np.zeros((3, 6, 8, 3), np.uint8))
    with pytest.raises(ValueError, match="views of 3 instants for 4 frames"):
        require_views(views(3), np.zeros((4, 6, 8, 3), np.uint8))
    with pytest.raises(ValueError, match="reference camera is of 6 x 8 pixels and the frames of 12 x 16"):
        require_views(views(3), np.zeros((3, 12, 16, 3), np.uint8))


def test_in_space_a_pixel_of_the_reference_is_a_unit_at_the_pivot() -> None:
    place = space()
    own = place.seen_by(place.reference)
    np.testing.assert_allclose(own.rotation, np.eye(3), atol=1e-12)
    np.testing.assert_allclose(own.position, 0, atol=1e-12)
    pivot = place.inside(place.pivot[None])
    np.testing.assert_allclose(pivot, [[0, 0, place.reference.focal[0]]], atol=1e-9)
    np.testing.assert_allclose(
        own.project(pivot + np.array([1.0, 0, 0])) - own.project(pivot), [[1.0, 0]], atol=1e-9
    )


def test_cameras_see_the_same_in_space_and_in_the_world() -> None:
    place, points = space(), np.random.default_rng(1).normal(size=(4, 3)) * 0.2
    for camera in arrange_cameras(place, ARRANGEMENT)[0]:
        np.testing.assert_allclose(
            place.seen_by(camera).project(place.inside(points)), camera.project(points), atol=1e-9
        )
    np.testing.assert_allclose(place.outside(place.inside(points)), points, atol=1e-12)


def test_the_grid_holds_the_reference_and_held_out_cameras_stand_between() -> None:
    cameras, names, held_out = arrange_cameras(space(), replace(ARRANGEMENT, columns=13, rows=5))
    assert len(cameras) == 67
    assert sum(held_out) == 2
    np.testing.assert_allclose(cameras[32].rotation, space().reference.rotation, atol=1e-12)
    assert names[32] == "yaw +0.0 pitch +0.0"
    middles = [camera.project(space().pivot[None])[0] for camera in cameras]
    np.testing.assert_allclose(middles, [space().reference.middle] * 67, atol=1e-9)


def test_settings_outside_their_domain_are_named() -> None:
    supervision = SupervisionConfig(weight=1.0, spread=0.2)
    for values, key in (({"weight": 0.0}, "weight"), ({"spread": 1.0}, "spread")):
        with pytest.raises(ValueError, match=rf"views\.\w+\.{key}="):
            replace(supervision, **values)
    for values, key in (
        ({"yaw_deg": 90.0}, "yaw_deg"),
        ({"rows": 0}, "rows"),
        ({"held_out": -1}, "held_out"),
    ):
        with pytest.raises(ValueError, match=rf"views\.\w+\.{key}="):
            replace(ARRANGEMENT, **values)
    with pytest.raises(ValueError, match=r"views\.sharp\.focal_35mm=0"):
        SharpConfig(None, None, None, focal_35mm=0.0, upscale=1, keep_clouds=False, blur_px2=0.3)
    with pytest.raises(ValueError, match=r"views\.kind=photos is none of simulated, rig, sharp"):
        ViewsConfig("photos", None, None, ARRANGEMENT, supervision)
    with pytest.raises(ValueError, match=r"views\.rig=None but kind rig needs it"):
        ViewsConfig("rig", None, None, None, supervision)
