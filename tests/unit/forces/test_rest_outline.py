"""The outline of what moves is that of the object, without ground that seems to move along."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from lagsplat.forces.rest_outline import draw_rest_mask, find_rest_mask
from lagsplat.matter.film_registration import list_pixels
from tests.matter_fields import make_linear_matter
from tests.unit.forces.rocking import CONTACT, HEIGHT, WIDTH, rocking

DISC = np.pi * 7.0**2


def test_the_outline_is_that_of_the_disc() -> None:
    seen = draw_rest_mask(rocking(), scale=2)
    assert seen.shape == (48, 64)
    assert seen[24, 32]
    assert not seen[:4].any()
    assert seen.sum() / 4 == pytest.approx(DISC, rel=0.05)


def test_ground_that_was_taken_for_matter_is_not_outlined() -> None:
    pixels = list_pixels(HEIGHT, WIDTH)
    pixels = pixels[(pixels - torch.tensor([16.0, 12.0])).norm(dim=1) < 9.5]
    arm = pixels - torch.tensor(CONTACT)
    motion = 0.1 * torch.stack([-arm[:, 1], arm[:, 0]], 1)[:, :, None]
    disc = rocking()
    both_ways = np.linspace(-6.0, 6.0, len(disc.chart.latents))[:, None]
    far = replace(disc.chart, latents=both_ways)  # so that it leaves the ground beside it
    wide = replace(disc, chart=far, matter=make_linear_matter(pixels, motion, bending=2))
    matter = wide.find_moving_parts().object
    shown = find_rest_mask(wide)
    assert matter.sum() > 1.5 * DISC
    assert shown.sum() < DISC + 0.8 * (matter.sum() - DISC)
    assert (shown <= matter).all()
    assert shown[12, 16]
