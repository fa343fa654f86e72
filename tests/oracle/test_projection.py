"""Projected Gaussians against cameras, differentiated projections, and gsplat's torch code."""

import numpy as np
import pytest
import torch
from torch import Tensor

from lagsplat.splat.gaussians import GaussianSlice
from lagsplat.splat.image_model import rasterize
from lagsplat.splat.projection import compute_depths, make_view, project
from lagsplat.views.camera import Camera, look_at, orbit_camera

HEIGHT, WIDTH, COUNT = 30, 44, 60


def cameras() -> list[Camera]:
    front = look_at(
        np.zeros(3), distance=50.0, yaw_deg=0, pitch_deg=0, view_width=40.0, height=HEIGHT, width=WIDTH
    )
    return [
        front,
        orbit_camera(front, 50.0, yaw_deg=14.0, pitch_deg=-6.0),
        orbit_camera(front, 45.0, yaw_deg=-9.0, pitch_deg=3.0),
    ]


def cloud(batch: int = 3, *, dtype: torch.dtype = torch.float64, spread: float = 15.0) -> GaussianSlice:
    generator = torch.Generator().manual_seed(4)

    def normal(*shape: int) -> Tensor:
        return torch.randn(*shape, generator=generator, dtype=dtype)

    factor = 0.8 * normal(COUNT, 3, 3) + torch.eye(3, dtype=dtype)
    row, column = torch.tril_indices(3, 3)
    return GaussianSlice(
        means=spread * normal(batch, COUNT, 3),
        covariance=(factor @ factor.mT)[:, row, column],
        opacity=torch.sigmoid(normal(batch, COUNT)),
        color=torch.sigmoid(normal(COUNT, 3)),
        background=torch.tensor([0.2, 0.3, 0.4], dtype=dtype),
    )


def seen(scene: GaussianSlice, chosen: list[Camera]) -> GaussianSlice:
    view = type(make_view(chosen))(*(part.to(scene.means) for part in make_view(chosen)))
    return project(scene, view, height=HEIGHT, width=WIDTH)


def order_of(scene: GaussianSlice, camera: Camera, image: int) -> np.ndarray:
    return np.argsort(camera.within(scene.means[image].numpy())[:, 2], kind="stable")


def test_centres_stand_where_the_cameras_see_them_nearest_first() -> None:
    scene, chosen = cloud(), cameras()
    flat = seen(scene, chosen)
    for image, camera in enumerate(chosen):
        order = order_of(scene, camera, image)
        np.testing.assert_allclose(
            flat.means[image], camera.project(scene.means[image].numpy())[order], atol=1e-3
        )
        np.testing.assert_allclose(flat.opacity[image], scene.opacity[image][order.copy()])
        np.testing.assert_allclose(flat.color[image], scene.color[order.copy()])
        ahead = compute_depths(
            scene.means, type(make_view(chosen))(*(part.double() for part in make_view(chosen)))
        )[image]
        np.testing.assert_allclose(ahead, camera.within(scene.means[image].numpy())[:, 2], atol=1e-4)


def test_shapes_are_those_of_the_linearised_projection() -> None:
    scene, chosen = cloud(spread=4.0), cameras()
    flat = seen(scene, chosen)
    full = torch.zeros(COUNT, 3, 3, dtype=torch.float64)
    row, column = torch.tril_indices(3, 3)
    full[:, row, column] = scene.covariance
    full[:, column, row] = scene.covariance
    for image, camera in enumerate(chosen):
        for place, k in enumerate(order_of(scene, camera, image)):
            turn, position = torch.from_numpy(camera.rotation), torch.from_numpy(camera.position)

            def onto(point: Tensor, turn: Tensor = turn, at: Tensor = position, lens=camera) -> Tensor:
                inside = turn @ (point - at)
                return torch.tensor(lens.focal) * inside[:2] / inside[2]

            slope = torch.autograd.functional.jacobian(onto, scene.means[image, k])
            expected = slope @ full[k] @ slope.T
            found = flat.covariance[image, place]
            np.testing.assert_allclose(
                found, [expected[0, 0], expected[0, 1], expected[1, 1]], rtol=2e-4, atol=1e-4
            )


def test_what_is_behind_or_not_finite_is_not_drawn_and_harms_no_gradient() -> None:
    scene, chosen = cloud(1), cameras()[:1]
    means = scene.means.clone()
    means[0, 0, 2], means[0, 1, 2], means[0, 2, 0] = -60.0, -50.0, torch.nan
    kept = scene._replace(opacity=scene.opacity.clone().index_fill_(1, torch.arange(3), 0.0))
    means.requires_grad_()
    images = rasterize(*seen(scene._replace(means=means), chosen), height=HEIGHT, width=WIDTH)
    expected = rasterize(*seen(kept, chosen), height=HEIGHT, width=WIDTH)
    torch.testing.assert_close(images, expected)
    images.sum().backward()
    assert means.grad is not None
    assert means.grad.isfinite().all()
    assert (means.grad[0, :3] == 0).all()


def test_far_off_the_picture_the_linearisation_stops() -> None:
    scene = cloud(1)
    aside = scene._replace(means=scene.means * 0 + torch.tensor([200.0, 0.0, -45.0]))
    flat = seen(aside, cameras()[:1])
    at_the_margin = aside._replace(
        means=scene.means * 0 + torch.tensor([0.5 * 1.3 * 40 / 50 * 5, 0.0, -45.0])
    )
    there = seen(at_the_margin, cameras()[:1]).covariance
    torch.testing.assert_close(flat.covariance, there, rtol=1e-5, atol=1e-5)


def test_the_projection_has_the_gradient_of_differences() -> None:
    scene, chosen = cloud(2, spread=5.0), cameras()[:2]
    few = [scene.means[:, :4], scene.covariance[:4], scene.opacity[:, :4], scene.color[:4], scene.background]
    inputs = [part.clone().requires_grad_() for part in few]
    assert torch.autograd.gradcheck(lambda *parts: seen(GaussianSlice(*parts), chosen)[:4], inputs)


def test_numba_draws_space_as_the_specification_does() -> None:
    """Shapes, colours and orders that differ between images, forward and backward."""
    single = cloud(dtype=torch.float32)
    results = []
    for backend, dtype in (("numba", torch.float32), ("torch", torch.float64)):
        inputs = [part.detach().to(dtype).requires_grad_() for part in single]
        scene = seen(GaussianSlice(*inputs), cameras())
        images = rasterize(*scene, height=HEIGHT, width=WIDTH, backend=backend)
        weight = torch.randn(images.shape, generator=torch.Generator().manual_seed(1))
        results.append((images, torch.autograd.grad((images * weight).sum(), inputs)))
    (mine, slopes), (reference, expected) = results
    torch.testing.assert_close(mine.double(), reference, atol=2e-4, rtol=0)
    for found, wanted in zip(slopes, expected, strict=True):
        assert (found - wanted).norm() <= 2e-3 * wanted.norm() + 1e-6


def test_the_nearer_of_two_covers_the_other_from_both_sides() -> None:
    red, blue = torch.tensor([1.0, 0.0, 0.0]), torch.tensor([0.0, 0.0, 1.0])
    front = cameras()[0]
    behind = orbit_camera(front, 50.0, yaw_deg=180.0, pitch_deg=0.0)
    scene = GaussianSlice(
        means=torch.tensor([[[0.0, 0.0, 5.0], [0.0, 0.0, -5.0]]]).repeat(2, 1, 1),
        covariance=torch.tensor([9.0, 0.0, 9.0, 0.0, 0.0, 9.0]).repeat(2, 1),
        opacity=torch.full((2, 2), 0.95),
        color=torch.stack([red, blue]),
        background=torch.zeros(3),
    )
    flat = project(scene, make_view([front, behind]), height=HEIGHT, width=WIDTH)
    images = rasterize(*flat, height=HEIGHT, width=WIDTH, backend="numba")
    middle = images[:, :, HEIGHT // 2, WIDTH // 2]
    assert middle[0, 2] > 0.8 > middle[0, 0]
    assert middle[1, 0] > 0.8 > middle[1, 2]


def test_gsplat_projects_alike() -> None:
    reference = pytest.importorskip("gsplat.cuda._torch_impl", reason="gsplat is not installed")
    scene, chosen = cloud(1, dtype=torch.float32), cameras()
    row, column = torch.tril_indices(3, 3)
    full = torch.zeros(COUNT, 3, 3)
    full[:, row, column] = scene.covariance
    full[:, column, row] = scene.covariance
    view = make_view(chosen)
    world = torch.eye(4).repeat(3, 1, 1)
    world[:, :3, :3], world[:, :3, 3] = view.rotation, view.translation
    lens = torch.stack([torch.as_tensor(camera.matrix(), dtype=torch.float32) for camera in chosen])
    _, centres, ahead, conics, _ = reference._fully_fused_projection(
        scene.means[0], full, world, lens, WIDTH, HEIGHT, eps2d=0.3
    )
    tripled = scene._replace(means=scene.means.repeat(3, 1, 1), opacity=scene.opacity.repeat(3, 1))
    flat = seen(tripled, chosen)
    for image in range(3):
        order = ahead[image].argsort(stable=True)
        torch.testing.assert_close(flat.means[image], centres[image][order], rtol=1e-4, atol=1e-3)
        xx, xy, yy = (flat.covariance[image].T + torch.tensor([[0.3], [0.0], [0.3]])).double()
        inverse = torch.stack([yy, -xy, xx], 1) / (xx * yy - xy**2)[:, None]
        torch.testing.assert_close(inverse.float(), conics[image][order], rtol=2e-3, atol=1e-4)
