"""Lagrangians to test laws on."""

import torch

from lagsplat.stage2.config import FormConfig
from lagsplat.stage2.decoder_mass import DecoderGeometry
from lagsplat.stage2.input_stiffness import InputRange, InputStiffness
from lagsplat.stage2.lagrangian import Coefficients, Floors, Lagrangian


def form(**changes: object) -> FormConfig:
    values = {
        "mass": "learned",
        "damping": "learned",
        "potential": "invex",
        "actuation": "bounded",
        "rest": "learned",
        "matrix_width": 16,
        "potential_width": 16,
        "actuation_width": 8,
        "diffeo_blocks": 2,
        "diffeo_width": 16,
        "diffeo_lipschitz": 0.9,
        "terms": "networks",
        "potential_degree": 3,
        "input_degree": 2,
        "matrix_degree": 1,
        "map_degree": 1,
    }
    return FormConfig(**(values | changes))


def bent(n_inputs: int, d: int, generator: torch.Generator, *, negative: float = 0.0) -> InputStiffness:
    """Curvatures of chamber volumes of either sign, and the largest inputs they are made for."""
    factor = torch.randn(n_inputs, d, d, generator=generator, dtype=torch.float64)
    largest = torch.ones(n_inputs, dtype=torch.float64)
    return split(0.3 * (factor + factor.mT), InputRange(largest, negative * largest))


def split(curvature: torch.Tensor, input_range: InputRange) -> InputStiffness:
    """Curvatures as the sum of what their positive and their negative eigenvalues do."""
    values, vectors = torch.linalg.eigh(curvature)
    stiffer, softer = ((vectors * part.clamp(min=0)[..., None, :]) @ vectors.mT for part in (values, -values))
    return InputStiffness(stiffer, softer, input_range)


def random_lagrangian(
    d: int,
    n_inputs: int,
    seed: int,
    *,
    start: Coefficients | None = None,
    amount: float = 0.3,
    negative: float = 0.0,
    **changes: object,
) -> Lagrangian:
    """A Lagrangian whose every parameter is moved by ``amount``, so that no term is at its silent start."""
    generator = torch.Generator().manual_seed(seed)
    square = torch.randn(3, d, d, generator=generator, dtype=torch.float64)
    spd = square @ square.mT + torch.eye(d, dtype=torch.float64)
    start = start or Coefficients(
        spd[0],
        0.2 * spd[1],
        spd[2],
        torch.randn(n_inputs, d, generator=generator, dtype=torch.float64),
        torch.randn(d, generator=generator, dtype=torch.float64),
        bent(n_inputs, d, generator, negative=negative),
    )
    geometry = None
    if changes.get("mass") == "induced":
        k = 30
        geometry = DecoderGeometry(
            torch.randn(k, 2, d, generator=generator, dtype=torch.float64),
            torch.randn(k, d, generator=generator, dtype=torch.float64),
            0.5 * torch.randn(k, d, d, generator=generator, dtype=torch.float64),
            torch.rand(k, generator=generator, dtype=torch.float64),
        )
    lagrangian = Lagrangian(
        start,
        form=form(**changes),
        floors=Floors(0.05, 0.02, 0.03),
        time_unit_s=0.1,
        seed=seed,
        geometry=geometry,
    )
    with torch.no_grad():
        for parameter in lagrangian.parameters():
            noise = torch.randn(parameter.shape, generator=generator, dtype=torch.float64)
            parameter.add_(amount * noise)
    lagrangian.project()
    return lagrangian
