"""A run in space in miniature whose kinematics is known: a plate that turns in the picture, before a wall."""

import numpy as np
import torch

from lagsplat.chart.chart import Chart
from lagsplat.forces.operating_point import OperatingPoint, hold_at_load
from lagsplat.matter.film_registration import list_pixels
from lagsplat.stage1.autoencoder import Autoencoder
from tests.matter_fields import make_linear_matter
from tests.unit.evaluate.tiny_run import lagrangian

HEIGHT, WIDTH, FOCAL = 24, 32, 100.0
FRONT, WALL = 90.0, 120.0
"""Depths of the plate and the wall; the pivot is at `FOCAL`."""


def turning(*, frames: int = 60) -> OperatingPoint:
    """A plate of radius 7 px around the middle turns about a point below it, in its own plane."""
    grid = torch.tensor([(x, y) for y in np.arange(1.0, 24, 2) for x in np.arange(1.0, 32, 2)])
    middle = torch.tensor([WIDTH / 2, HEIGHT / 2])
    plate = grid[(grid - middle).norm(dim=1) < 7.0]
    places = torch.cat([spread(grid - middle, WALL), spread(plate - middle, FRONT)])
    on = torch.arange(len(places)) >= len(grid)
    turn = turn_in_picture(places)
    size = {"height": HEIGHT, "width": WIDTH}
    model = Autoencoder(
        d=1,
        n_gaussians=len(places),
        kernel=12,
        channels=2,
        background="black",
        lens=[FOCAL, FOCAL, WIDTH / 2, HEIGHT / 2],
        backend="auto",
        **size,
    )
    gaussians = model.gaussians
    with torch.no_grad():
        gaussians.center.copy_(places)
        gaussians.precision_log_diagonal.fill_(np.log(0.2))
        gaussians.coupling.copy_(torch.where(on[:, None, None], 0.5 * turn, 0.0))
        gaussians.opacity_logit.fill_(3.0)
        gaussians.color_logit.copy_(torch.where(on[:, None], 2.0, -1.0).expand(-1, 3))
    eye, time_s = np.eye(1), np.arange(frames) / 60
    swing = np.sin(3.0 * time_s)[:, None]
    chart = Chart(
        mean=np.zeros(1),
        whiten=eye,
        unwhiten=eye,
        metric=eye,
        metric_scale=1.0,
        latents=swing,
        inputs=np.zeros((frames, 1)),
        time_s=time_s,
        rest=np.zeros(1),
        n_train=frames,
        segments=((0, frames),),
        smoothing_frames=1.0,
        condition=1.0,
        intrinsic_dimension=1.0,
        refinement_steps=0,
        visibility_step=2e-2,
    )
    pixels = list_pixels(HEIGHT, WIDTH) - middle
    points = spread(pixels[pixels.norm(dim=1) < 7.0], FRONT)
    matter = make_linear_matter(points, 0.1 * turn_in_picture(points))
    return hold_at_load(model.eval(), chart, lagrangian(1), matter)


def turn_in_picture(places: torch.Tensor) -> torch.Tensor:
    """Motion of places that turn about a point below the middle, in the plane of the picture."""
    arm = places[:, :2] - torch.tensor([0.0, 7.0])
    return torch.stack([-arm[:, 1], arm[:, 0], torch.zeros(len(places))], 1)[:, :, None]


def spread(offset: torch.Tensor, depth: float) -> torch.Tensor:
    """Points at a depth that are seen this far [px] from the middle."""
    return torch.cat([offset * depth / FOCAL, torch.full((len(offset), 1), depth)], 1)
