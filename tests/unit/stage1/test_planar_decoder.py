"""Two decoders at equal terms."""

import numpy as np
import pytest
import torch

from lagsplat.stage1.config import PlanarDecoderConfig
from lagsplat.stage1.planar_decoder import (
    CONDITIONED,
    DEFORMED,
    DeformedGaussians,
    fit_planar_decoder,
    load_planar_decoder,
    save_planar_decoder,
    start_planar_decoder,
)
from tests.unit.stage1.problems import small_config, swinging_bar

FRAMES = swinging_bar(40)
LATENTS = np.sin(np.arange(40) / 3)[:, None]


def settings(**changes: object) -> PlanarDecoderConfig:
    values = {
        "n_gaussians": 40,
        "hidden": 16,
        "shift_limit": 1.0,
        "shape_limit": 3.0,
        "steps": 60,
        "batch": 4,
        "neighbours": 3,
    }
    return PlanarDecoderConfig(**(values | changes))


def test_both_begin_as_the_same_planar_gaussians() -> None:
    decoders = [
        start_planar_decoder(kind, FRAMES, LATENTS, settings(), small_config(), seed=0)
        for kind in (CONDITIONED, DEFORMED)
    ]
    ours, theirs = (dict(decoder.gaussians.named_parameters()) for decoder in decoders)
    shared = set(ours) & set(theirs)
    assert shared >= {"center", "shape_log_diagonal", "opacity_logit", "color_logit", "background_logit"}
    for name in shared:
        torch.testing.assert_close(ours[name], theirs[name])
    count = sum(parameter.numel() for parameter in decoders[1].parameters())
    assert count == 9 * 40 + 3 + 2 * 16 + 16 * 16 + 16 + 5 * 40 * 17


def test_an_untrained_network_moves_nothing_and_its_limits_hold() -> None:
    torch.manual_seed(0)
    gaussians = DeformedGaussians(5, 2, hidden=8, shift_limit=4.0, shape_limit=3.0)
    z = torch.randn(3, 2)
    assert float(gaussians.jacobian(z[0]).abs().max()) == 0.0
    torch.testing.assert_close(gaussians.centers(z)[0], gaussians.center)
    with torch.no_grad():
        gaussians.head.weight.fill_(50.0)
    assert float((gaussians.centers(z) - gaussians.center).abs().max().detach()) <= 4.0


def test_its_jacobian_is_how_centres_really_move() -> None:
    torch.manual_seed(1)
    gaussians = DeformedGaussians(5, 2, hidden=8, shift_limit=4.0, shape_limit=3.0).double()
    with torch.no_grad():
        gaussians.head.weight.normal_(std=0.3)
    z, step = torch.tensor([0.2, -0.4], dtype=torch.float64), 1e-6
    with torch.no_grad():
        moved = [
            (gaussians.centers((z + step * e)[None])[0] - gaussians.centers((z - step * e)[None])[0])
            / (2 * step)
            for e in torch.eye(2, dtype=torch.float64)
        ]
    torch.testing.assert_close(gaussians.jacobian(z), torch.stack(moved, -1), rtol=1e-5, atol=1e-7)


@pytest.mark.parametrize("kind", [CONDITIONED, DEFORMED])
def test_each_learns_to_draw_the_film(kind: str, tmp_path) -> None:
    config = settings(steps=120)
    decoder, story = fit_planar_decoder(kind, FRAMES, LATENTS, config, small_config(), seed=0)
    start = start_planar_decoder(kind, FRAMES, LATENTS, config, small_config(), seed=0)
    errors = []
    truth = torch.from_numpy(np.moveaxis(FRAMES[:8], 3, 1) / 255.0).float()
    for one in (start, decoder):
        with torch.no_grad():
            drawn = one.draw(one.slices(torch.as_tensor(LATENTS[:8]).float()), backend="numba")
        errors.append(float((drawn - truth).abs().mean()))
    assert errors[1] < 0.7 * errors[0]
    assert story.wall_s > 0
    save_planar_decoder(tmp_path / "decoder.safetensors", decoder, {"steps": 120})
    again, header = load_planar_decoder(tmp_path / "decoder.safetensors")
    assert (again.kind, header["steps"]) == (kind, 120)
    z = torch.tensor([0.3])
    torch.testing.assert_close(again.jacobian(z), decoder.jacobian(z))


def test_what_makes_no_sense_is_refused() -> None:
    with pytest.raises(ValueError, match="no decoder 'both'"):
        start_planar_decoder("both", FRAMES, LATENTS, settings(), small_config(), seed=0)
    with pytest.raises(ValueError, match=r"deformation\.hidden"):
        settings(hidden=0)
    with pytest.raises(ValueError, match="fewer than"):
        settings(neighbours=40)
