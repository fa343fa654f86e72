"""Clicks on something and on nothing."""

import math

import pytest
import torch

from lagsplat.forces.grasp import (
    MatterKinematics,
    NoMatterError,
    compute_kinematics,
    grasp_brush,
    grasp_nearest,
)
from lagsplat.stage2.decoder_mass import DecoderGeometry
from tests.unit.evaluate.tiny_run import autoencoder, chart, recording

STILL = torch.zeros(1, dtype=torch.float64)


def two() -> MatterKinematics:
    """One Gaussian that moves right and fades away from q = 0, and one that never moves."""
    return MatterKinematics(
        DecoderGeometry(
            jacobian=torch.tensor([[[2.0], [0.0]], [[0.0], [0.0]]], dtype=torch.float64),
            center=torch.zeros(2, 1, dtype=torch.float64),
            precision_factor=torch.ones(2, 1, 1, dtype=torch.float64),
            opacity=torch.tensor([0.5, 1.0], dtype=torch.float64),
        ),
        center=torch.tensor([[4.0, 5.0], [8.0, 5.0]], dtype=torch.float64),
        height=10,
        width=20,
    )


def test_weights_are_those_of_the_paper_and_sum_to_one():
    grip = grasp_brush(two(), STILL, (4.0, 5.0), radius=2.0)
    far = math.exp(-0.5 * (4.0 / 2.0) ** 2)
    share = 0.5 / (0.5 + far)
    assert float(grip.weights.sum()) == pytest.approx(1.0)
    assert float(grip.weights[0]) == pytest.approx(share)
    force = torch.tensor([3.0, 7.0], dtype=torch.float64)
    assert float(grip.pull_back(force)) == pytest.approx(share * 2.0 * 3.0)


def test_the_selection_follows_the_matter():
    grip = grasp_brush(two(), STILL, (4.5, 5.5), radius=0.3)
    torch.testing.assert_close(
        grip.place(torch.tensor([1.5], dtype=torch.float64)), torch.tensor([7.5, 5.5], dtype=torch.float64)
    )


def test_the_nearest_is_one_gaussian():
    grip = grasp_nearest(two(), STILL, (7.0, 9.0))
    assert grip.weights.tolist() == [0.0, 1.0]
    assert float(grip.pull_back(torch.ones(2, dtype=torch.float64))) == 0.0


@pytest.mark.parametrize(
    "take", [lambda *a: grasp_brush(*a, radius=1.0), grasp_nearest], ids=["brush", "nearest"]
)
def test_a_point_outside_and_a_state_where_nothing_is_drawn_are_refused(take):
    with pytest.raises(NoMatterError, match="outside the image of 20 x 10 px"):
        take(two(), STILL, (20.5, 5.0))
    with pytest.raises(NoMatterError, match="no Gaussian is present at the state"):
        take(two(), STILL + 9.0, (4.0, 5.0))
    with pytest.raises(ValueError, match="not finite"):
        take(two(), STILL * torch.nan, (4.0, 5.0))
    with pytest.raises(ValueError, match="not finite"):
        take(two(), STILL, (math.nan, 5.0))


def test_a_click_on_the_background_colour_and_a_brush_without_width_are_refused():
    with pytest.raises(NoMatterError, match=r"nothing is present within a brush of 0\.5 px"):
        grasp_brush(two(), STILL, (15.0, 1.0), radius=0.5)
    with pytest.raises(ValueError, match="positive"):
        grasp_brush(two(), STILL, (4.0, 5.0), radius=0.0)


def test_the_kinematics_is_that_of_the_drawn_gaussians():
    model = autoencoder()
    of = chart(model, recording())
    kinematics = compute_kinematics(model, of)
    q = torch.from_numpy(of.latents[3:6])
    with torch.no_grad():
        drawn = model.gaussians.double().condition(torch.from_numpy(of.to_raw(of.latents[3:6])))
    torch.testing.assert_close(kinematics.places(q), drawn.means)
    torch.testing.assert_close(kinematics.presence(q), drawn.opacity)
    assert (kinematics.d, kinematics.height, kinematics.width) == (2, 16, 16)
