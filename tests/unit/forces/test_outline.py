"""The object is cut out where it ends, and nothing else."""

import torch

from lagsplat.forces.moving_parts import draw_outline, find_moving_parts
from tests.unit.forces.rocking import rocking


def test_the_disc_is_cut_out_of_the_wall():
    operating_point = rocking()
    scene = find_moving_parts(
        operating_point.autoencoder, operating_point.chart, operating_point.rest.numpy()
    )
    seen = draw_outline(operating_point.render_images(operating_point.rest[None], scale=2)[0], scene)
    assert seen.shape == (48, 64)
    assert seen[24, 32]
    assert not seen[:4].any()
    assert torch.pi * 5.0**2 < seen.sum() / 4 < torch.pi * 9.0**2
