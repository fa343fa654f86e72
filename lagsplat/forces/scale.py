"""The one number that a film does not tell: how much energy of the law is a joule."""

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.forces.held import Held

SIZES = 81
SPAN = 1e4


class NoScaleError(ValueError):
    """A poke that no energy scale makes the law answer as measured; the message says why."""


def share_of(
    answer: Float64[np.ndarray, "*B P n"], measured: Float64[np.ndarray, "P n"]
) -> Float64[np.ndarray, "*B"]:
    """How much of the measured ways an answer makes, by least squares: 1 where it is as large."""
    return np.einsum("...pc,pc->...", answer, measured) / np.sum(measured**2)


def energy_scale(
    held: Held,
    load: Float64[np.ndarray, " d"],
    jacobian: Float64[np.ndarray, "P n d"],
    measured: Float64[np.ndarray, "P n"],
) -> float:
    """The factor kappa with which the law answers ``kappa load`` by as much as was ``measured``.

    ``load`` is a known force, pulled back; ``measured`` are the ways [px] of points of the object, whose
    matter the model moves by ``jacobian``. One poke decides, and kappa is one for the whole model.

    Raises:
        NoScaleError: the answer does not grow along the measured ways, whatever the force.

    Source: paper, "Interaction and Inference", the energy factor.
    """
    direction = torch.from_numpy(load)

    def shares(sizes: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        away = (held.settled(torch.from_numpy(sizes)[:, None] * direction) - held.rest).numpy()
        return share_of(np.einsum("pcd,nd->npc", jacobian, away), measured)

    small = 1e-3 * held.reach / max(float(np.linalg.norm(load)), 1e-300)
    slope = float(shares(np.array([small]))[0]) / small
    if not slope > 0.0:
        raise NoScaleError(
            "the law answers this poke against the measured way, or not at all: no energy scale makes them "
            "agree; poke another point"
        )
    sizes = np.geomspace(1.0 / np.sqrt(SPAN), np.sqrt(SPAN), SIZES) / slope
    found = shares(sizes)
    after = int(np.argmax(found >= 1.0))
    if after == 0:
        raise NoScaleError(
            "no energy scale within four decades makes the law answer as measured; poke softer"
        )
    low, high = np.log(np.maximum(found[after - 1 : after + 1], 1e-300))
    ratio = -low / (high - low)
    return float(np.exp(np.log(sizes[after - 1]) + ratio * np.log(sizes[after] / sizes[after - 1])))
