"""Runs in miniature whose kinematics is known: a disc that rocks about its lower edge, an arm that hangs."""

from collections.abc import Callable
from dataclasses import replace

import numpy as np
import torch

from lagsplat.chart.chart import Chart
from lagsplat.forces.operating_point import OperatingPoint, hold_at_load
from lagsplat.matter.film_registration import list_pixels
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage2.equilibrium import find_equilibrium
from lagsplat.stage2.likelihood.parameter_vector import POTENTIAL, ParameterVector
from tests.matter_fields import make_linear_matter
from tests.stage2_problems import random_lagrangian
from tests.unit.evaluate.tiny_run import lagrangian

HEIGHT, WIDTH = 24, 32
CONTACT = (16.0, 19.0)
CLAMP = (16.0, 2.0)


def rocking(*, frames: int = 60) -> OperatingPoint:
    """A disc of radius 7 px around (16, 12) that turns about `CONTACT`, before a wall that stands still."""
    places = torch.tensor([(x, y) for y in np.arange(1.0, 24, 2) for x in np.arange(1.0, 32, 2)])

    def covers(places: torch.Tensor) -> torch.Tensor:
        return (places - torch.tensor([16.0, 12.0])).norm(dim=1) < 7.0

    def move(places: torch.Tensor) -> torch.Tensor:
        arm = places - torch.tensor(CONTACT)
        return 0.1 * torch.stack([-arm[:, 1], arm[:, 0]], 1)[:, :, None]

    return _held(places, covers, move, frames=frames)


def hanging(*, frames: int = 60) -> OperatingPoint:
    """A strip 4 px wide that hangs from `CLAMP`: one coordinate bends it, the other stretches it."""
    places = torch.tensor([(x, y) for y in np.arange(1.0, 24, 1.5) for x in np.arange(1.0, 32, 1.5)])

    def covers(places: torch.Tensor) -> torch.Tensor:
        down = places[:, 1] - CLAMP[1]
        return ((places[:, 0] - CLAMP[0]).abs() < 2.5) & (down > 0) & (down < 21)

    def move(places: torch.Tensor) -> torch.Tensor:
        down = places[:, 1] - CLAMP[1]
        bend = torch.stack([0.01 * down**2, 0.0 * down], 1)
        stretch = torch.stack([0.0 * down, 0.08 * down], 1)
        return torch.stack([bend, stretch], 2)

    return _held(places, covers, move, frames=frames)


def _held(
    places: torch.Tensor,
    covers: Callable[[torch.Tensor], torch.Tensor],
    move: Callable[[torch.Tensor], torch.Tensor],
    *,
    frames: int,
) -> OperatingPoint:
    """A run whose decoder and matter move alike where an object ``covers`` the picture."""
    on = covers(places)
    jacobian = torch.where(on[:, None, None], move(places), 0.0)
    pixels = list_pixels(HEIGHT, WIDTH)
    pixels = pixels[covers(pixels)]
    n, d = len(places), jacobian.shape[2]
    size = {"height": HEIGHT, "width": WIDTH}
    model = Autoencoder(d=d, n_gaussians=n, kernel=12, channels=2, background="black", backend="auto", **size)
    gaussians = model.gaussians
    with torch.no_grad():
        gaussians.center.copy_(places)
        gaussians.precision_log_diagonal.fill_(np.log(0.2))
        gaussians.coupling.copy_(jacobian / 0.2)
        gaussians.opacity_logit.fill_(3.0)
        gaussians.color_logit.copy_(torch.where(on[:, None], 2.0, -1.0).expand(-1, 3))
    eye, time_s = np.eye(d), np.arange(frames) / 60
    swing = np.stack([np.sin((3.0 + 2.0 * i) * time_s) for i in range(d)], 1)
    chart = Chart(
        mean=np.zeros(d),
        whiten=eye,
        unwhiten=eye,
        metric=eye,
        metric_scale=1.0,
        latents=swing,
        inputs=np.zeros((frames, 1)),
        time_s=time_s,
        rest=np.zeros(d),
        n_train=frames,
        segments=((0, frames),),
        smoothing_frames=1.0,
        condition=1.0,
        intrinsic_dimension=float(d),
        refinement_steps=0,
        visibility_step=2e-2,
    )
    matter = make_linear_matter(pixels, move(pixels), bending=2)
    return hold_at_load(model.eval(), chart, lagrangian(d), matter)


def hold_polynomial_strip() -> OperatingPoint:
    """The hanging strip under a law of polynomials, at its rest."""
    return hold_under_polynomials(hanging())


def hold_under_polynomials(point: OperatingPoint) -> OperatingPoint:
    """The same run under a random law of polynomials, at its rest."""
    law = random_lagrangian(point.law.d, 1, 3, amount=0.02, terms="polynomial", map_degree=1)
    return replace(point, law=law, rest=find_equilibrium(law, point.u))


def draw_springs(point: OperatingPoint, *, deviation: float) -> np.ndarray:
    """Parameters of 40 laws whose springs of the coordinate that stretches differ by this share."""
    parameters = ParameterVector(point.law)
    square = point.law.energy.exponents.tolist().index([0.0, 2.0])
    draws = np.tile(parameters.read().numpy(), (40, 1))
    draws[:, int(parameters.find_columns(POTENTIAL)[square])] *= 1.0 + deviation * np.tile([-1.0, 1.0], 20)
    return draws


def deviate_stretch(point: OperatingPoint, *, share: float) -> OperatingPoint:
    """The same run, whose motion along the last coordinate is known up to a share."""
    (body,) = point.matter.bodies
    deviation = torch.zeros_like(body.coefficients)
    deviation[body.d - 1] = share * body.coefficients[body.d - 1]
    bodies = (replace(body, deviations=(deviation,)),)
    return replace(point, matter=replace(point.matter, bodies=bodies))
