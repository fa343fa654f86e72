"""Fields of matter whose motion is given."""

from dataclasses import replace

import torch

from lagsplat.matter.body_motion import make_body_at_rest
from lagsplat.matter.field import MatterField
from lagsplat.monomials import make_wide_ball


def make_linear_matter(points: torch.Tensor, jacobian: torch.Tensor, *, bending: int = 1) -> MatterField:
    """One body whose points move straight with the state by ``jacobian`` (P, n, d), a polynomial of place."""
    body = make_body_at_rest(points.double(), make_wide_ball(jacobian.shape[2]), bending=bending)
    basis = body.evaluate_basis(points.double())
    motion = jacobian.double().flatten(1) / body.size
    # PyTorch's default driver reads memory that it did not write: a flat body sometimes gets no motion.
    pose = torch.linalg.lstsq(basis, motion, driver="gelsd").solution  # (m, n d)
    coefficients = pose.unflatten(1, jacobian.shape[1:]).permute(2, 1, 0).flatten(1)
    return MatterField(
        (replace(body, coefficients=coefficients),), points.double(), torch.zeros(len(points)).long()
    )
