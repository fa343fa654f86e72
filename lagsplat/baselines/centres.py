"""Where the attention of each node lies, and how fast it moves."""

import torch
from jaxtyping import Float
from torch import Tensor

from lagsplat.baselines.abcd import AttentionDecoder, Maps
from lagsplat.baselines.pixels import Places
from lagsplat.shapes import Latents

EPSILON = 1e-8  # added to the mass of a map

Centres = Float[Tensor, "B G 2"]


def centres(maps: Maps, places: Places) -> Centres:
    """Centre of mass ``(y, x)`` of the squared maps."""
    weight = maps.square()
    return weight @ places / (weight.sum(-1, keepdim=True) + EPSILON)


def moving_centres(maps: Maps, rates: Maps, places: Places) -> tuple[Centres, Centres]:
    """The same with its velocity [1/s], from the maps and their rates [1/s]."""
    weight, change = maps.square(), 2.0 * maps * rates
    mass = weight.sum(-1, keepdim=True) + EPSILON
    moment = weight @ places
    velocity = (change @ places * mass - moment * change.sum(-1, keepdim=True)) / mass.square()
    return moment / mass, velocity


def centre_jacobian(decoder: AttentionDecoder, z: Latents) -> Float[Tensor, "B G 2 d"]:
    """How each centre moves with each coordinate."""

    def place(one: Tensor) -> Tensor:
        return centres(decoder.maps(one[None]), decoder.places)[0]

    return torch.func.vmap(torch.func.jacrev(place))(z)
