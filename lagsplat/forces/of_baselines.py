"""Where a force that is given in the image can act: each model is asked, and answers by what it does.

Two things are needed. The decoder has to carry the force back to the coordinates, and the law has to turn
what arrives there into an acceleration.

Source: paper, the last column of Table "Krauss".
"""

import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.baselines.abcd import AttentionDecoder
from lagsplat.baselines.centres import centre_jacobian
from lagsplat.baselines.model import Baseline
from lagsplat.baselines.oscillators import Oscillators
from lagsplat.shapes import Latents

ASKED = 8  # states at which a model is asked

Forces = Float[Tensor, "B G 2"]


def pulled_back(baseline: Baseline, z: Latents, forces: Forces) -> Latents | None:
    """Forces ``(y, x)`` on the centres of the maps as forces on the coordinates; None where nothing in the
    decoder has a place.

    A planar node has one centre for its two coordinates, and their map into the plane is square. One map a
    coordinate is half of that: it says where the coordinate is drawn, and no planar position is left to push.
    """
    if not isinstance(baseline.decoder, AttentionDecoder) or baseline.decoder.group != 2:
        return None
    return torch.einsum("bgcd,bgc->bd", centre_jacobian(baseline.decoder, z), forces)


def accelerated(baseline: Baseline, z: Latents, push: Latents) -> Latents | None:
    """The acceleration [1/s^2] that a force on the coordinates adds; None where the law takes no force."""
    law = baseline.dynamics
    if not isinstance(law, Oscillators):
        return None
    architecture, still = baseline.architecture, torch.zeros_like(z)
    u = torch.zeros(len(z), architecture.samples * architecture.n_inputs)
    return (law(z, still, u, push)[1] - law(z, still, u)[1]) / law.dt_s


@torch.no_grad()
def reach(baseline: Baseline, z: Latents) -> str:
    """``none``, ``latent only``, or at how many centres: what a push at the states ``z`` brings about."""
    answer = accelerated(baseline, z, torch.ones_like(z))
    if answer is None or not _moves(answer):
        return "none"
    nodes = baseline.decoder.n_nodes if isinstance(baseline.decoder, AttentionDecoder) else 0
    reached = 0
    for node in range(nodes):
        forces = torch.zeros(len(z), nodes, 2)
        forces[:, node] = 1.0
        push = pulled_back(baseline, z, forces)
        answer = None if push is None else accelerated(baseline, z, push)
        reached += answer is not None and _moves(answer)
    return f"at {reached} centres" if reached else "latent only"


def _moves(acceleration: Tensor) -> bool:
    return bool(torch.isfinite(acceleration).all() and acceleration.abs().amax() > 0)
