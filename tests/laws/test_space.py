"""Laws of pictures of space, whatever the scene and the cameras."""

import numpy as np
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st

from lagsplat.splat.gaussians import GaussianSlice
from lagsplat.splat.image_model import ALPHA_MIN, rasterize
from lagsplat.splat.projection import View, make_view, project
from lagsplat.views.camera import Camera, look_at, orbit_camera

FEW = settings(max_examples=15, deadline=None)
SEEDS = st.integers(0, 2**31)
ANGLES = st.floats(-40.0, 40.0)
HEIGHT, WIDTH, COUNT = 14, 18, 25
SIZE = {"height": HEIGHT, "width": WIDTH}


def scene(seed: int) -> GaussianSlice:
    generator = torch.Generator().manual_seed(seed)

    def normal(*shape: int) -> torch.Tensor:
        return torch.randn(*shape, generator=generator, dtype=torch.float64)

    factor = normal(COUNT, 3, 3)
    row, column = torch.tril_indices(3, 3)
    return GaussianSlice(
        3.0 * normal(1, COUNT, 3),
        (factor @ factor.mT)[:, row, column],
        torch.sigmoid(normal(1, COUNT)),
        torch.sigmoid(normal(COUNT, 3)),
        torch.sigmoid(normal(3)),
    )


def camera(yaw: float = 0.0, pitch: float = 0.0, *, distance: float = 40.0) -> Camera:
    return look_at(
        np.zeros(3), distance=distance, yaw_deg=yaw, pitch_deg=pitch, view_width=0.45 * distance, **SIZE
    )


def seen(cloud: GaussianSlice, by: Camera) -> torch.Tensor:
    view = View(*(part.double() for part in make_view([by])))
    return rasterize(*project(cloud, view, **SIZE), **SIZE)


def packed(full: torch.Tensor) -> torch.Tensor:
    row, column = torch.tril_indices(3, 3)
    return full[:, row, column]


def unpacked(entries: torch.Tensor) -> torch.Tensor:
    row, column = torch.tril_indices(3, 3)
    full = torch.zeros(len(entries), 3, 3, dtype=entries.dtype)
    full[:, row, column] = entries
    full[:, column, row] = entries
    return full


def assert_same_image(image: torch.Tensor, expected: torch.Tensor) -> None:
    """Equal up to rounding, which may carry one Gaussian of a few pixels over the least alpha drawn."""
    difference = (image - expected).abs().amax((0, 1))
    assert difference.max() <= ALPHA_MIN
    assert (difference > 1e-6).sum() <= 0.02 * HEIGHT * WIDTH


@FEW
@given(seed=SEEDS, yaw=ANGLES, pitch=ANGLES)
@example(seed=109261, yaw=0.0, pitch=1.0)  # a Gaussian at the least alpha drawn
def test_what_turns_with_its_camera_looks_the_same(seed: int, yaw: float, pitch: float) -> None:
    cloud, turned = scene(seed), orbit_camera(camera(), 40.0, yaw_deg=yaw, pitch_deg=pitch)
    turn = torch.from_numpy(turned.rotation.T @ camera().rotation)
    moved = cloud._replace(
        means=cloud.means @ turn.T, covariance=packed(turn @ unpacked(cloud.covariance) @ turn.T)
    )
    assert_same_image(seen(moved, turned), seen(cloud, camera()))


@FEW
@given(seed=SEEDS, factor=st.floats(0.2, 20.0))
def test_what_grows_with_its_distance_looks_the_same(seed: int, factor: float) -> None:
    cloud = scene(seed)
    grown = cloud._replace(means=factor * cloud.means, covariance=factor**2 * cloud.covariance)
    near, far = camera(), camera(distance=40.0 * factor)
    assert_same_image(seen(grown, far), seen(cloud, near))


@FEW
@given(seed=SEEDS)
def test_the_order_in_which_gaussians_are_told_says_nothing(seed: int) -> None:
    cloud = scene(seed)
    order = torch.randperm(COUNT, generator=torch.Generator().manual_seed(seed))
    shuffled = GaussianSlice(
        cloud.means[:, order],
        cloud.covariance[order],
        cloud.opacity[:, order],
        cloud.color[order],
        cloud.background,
    )
    torch.testing.assert_close(
        seen(shuffled, camera(20, 10)), seen(cloud, camera(20, 10)), atol=1e-12, rtol=0
    )


@FEW
@given(seed=SEEDS, yaw=ANGLES, color=st.floats(0, 1))
def test_a_world_of_one_color_is_that_color_from_everywhere(seed: int, yaw: float, color: float) -> None:
    cloud = scene(seed)
    cloud.color.fill_(color)
    cloud.background.fill_(color)
    images = seen(cloud, camera(yaw))
    torch.testing.assert_close(images, torch.full_like(images, color), atol=1e-9, rtol=0)
