"""Blurred frames are read where a camera sees points, but for what is unknown of them."""

import numpy as np
import torch

from lagsplat.matter.blurred_film import BlurredFilm, CameraFilm, blur_frames, project_points
from lagsplat.views.camera import center_camera, orbit_camera

FRONT = center_camera(np.eye(3), np.zeros(3), focal=50.0, height=20, width=24)
ASIDE = orbit_camera(FRONT, 50.0, yaw_deg=20.0, pitch_deg=10.0)


def open_film(film: CameraFilm) -> BlurredFilm:
    colors, share = blur_frames(film, blur_px=1.0)
    known = None if share is None else torch.from_numpy(share)[:, None]
    return BlurredFilm(torch.from_numpy(colors).movedim(3, 1), film.camera, known)


def test_holes_are_unknown_and_do_not_bleed() -> None:
    cover = np.full((1, 20, 24), 255, np.uint8)
    cover[:, :, :12] = 0
    frames = np.where(cover[..., None] > 0, 100, 255).astype(np.uint8).repeat(3, 3)
    places = torch.tensor([[[3.5, 9.5], [11.5, 9.5], [14.5, 9.5], [20.5, 9.5], [30.0, 9.5]]]).double()
    seen = open_film(CameraFilm(frames, None, cover)).sample(slice(None), places)
    assert seen.inside.tolist() == [[False, False, True, True, False]]
    torch.testing.assert_close(seen.color[0, 2:4], torch.full((2, 3), 100 / 255).double(), atol=1e-5, rtol=0)
    assert open_film(CameraFilm(frames)).sample(slice(None), places).inside.tolist() == [[True] * 4 + [False]]


def test_places_are_those_of_the_camera_and_nothing_behind_it_is_in_the_image() -> None:
    points = torch.tensor([[1.0, -2.0, 48.0], [-3.0, 1.0, 55.0], [0.0, 0.0, -40.0]]).double()
    places, slope = project_points(ASIDE, points)
    np.testing.assert_allclose(places[:2], ASIDE.project(points[:2].numpy()), rtol=1e-12)
    assert (places[2] < 0.0).all()
    jacobian = torch.autograd.functional.jacobian(lambda x: project_points(ASIDE, x)[0], points[0])
    torch.testing.assert_close(slope[0], jacobian)


def test_gradients_are_those_of_the_colour_by_the_place_in_space() -> None:
    columns, rows = np.meshgrid(np.arange(24.0), np.arange(20.0))
    frame = 120 + 60 * np.stack([np.sin(columns / 5), np.cos(rows / 4), np.sin((columns + rows) / 6)], 2)
    film = open_film(CameraFilm(np.round(frame[None]).astype(np.uint8), ASIDE))
    point, step = torch.tensor([[[1.0, -2.0, 48.0]]]).double(), 0.5
    seen = film.sample(slice(None), point)
    for axis, way in enumerate(step * torch.eye(3).double()):
        after, before = (film.sample(slice(None), point + sign * way).color for sign in (1, -1))
        torch.testing.assert_close(
            seen.gradient[..., axis], (after - before) / (2 * step), atol=2e-3, rtol=0.1
        )
