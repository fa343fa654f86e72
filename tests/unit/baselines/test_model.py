"""Shapes and laws of the four models, before any training."""

import numpy as np
import pytest
import torch

from lagsplat.baselines.model import (
    Baseline,
    BaselineArchitecture,
    Koopman,
    Oscillators,
    load_baseline,
    save_baseline,
    stack_delays,
)
from lagsplat.baselines.networks import (
    compute_attention_centres,
    compute_centre_jacobian,
    compute_closing_rates,
    compute_moving_centres,
    measure_disagreement,
    penalize_unwarranted_change,
)
from tests.unit.baselines.problems import DT_S, architecture

KINDS = [(decoder, law) for decoder in ("deconv", "abcd") for law in ("oscillators", "koopman")]
SIZES = {"oscillators": {8: 1692, 10: 2054}, "koopman": {8: 672, 10: 1012}}


@pytest.mark.parametrize(("d", "n_inputs"), [(8, 2), (10, 4)])
@pytest.mark.parametrize(("decoder", "law"), KINDS)
def test_sizes_are_the_published_ones(decoder, law, d, n_inputs):
    baseline = Baseline(architecture(decoder, law, d=d, n_inputs=n_inputs, height=32, width=32))

    def count(part):
        return sum(parameter.numel() for parameter in part.parameters())

    assert count(baseline.encoder) == {8: 198384, 10: 206580}[d]
    drawn = {("deconv", 8): 183907, ("deconv", 10): 188003}
    drawn |= (
        {("abcd", 8): 40332 - 5, ("abcd", 10): 40685 - 5}  # less the five that are never used
        if law == "oscillators"
        else {("abcd", 8): 31883, ("abcd", 10): 32301}
    )
    assert count(baseline.decoder) == drawn[decoder, d]
    paired = (decoder, law) == ("abcd", "oscillators")
    assert count(baseline.dynamics) == SIZES[law][d] + (d // 2 if paired else 0)


@pytest.mark.parametrize(("decoder", "law"), KINDS)
def test_images_of_any_multiple_of_eight_survive_the_file(tmp_path, decoder, law):
    baseline = Baseline(architecture(decoder, law)).eval()
    images = torch.rand(3, 3, 16, 24)
    mean, log_variance = baseline.encoder(images)
    assert (mean.shape, log_variance.shape) == ((3, 4), (3, 4))
    drawn = baseline.decode(mean)
    assert drawn.shape == images.shape
    assert 0 <= drawn.min() <= drawn.max() <= 1
    save_baseline(tmp_path / "b.safetensors", baseline, {"seed": 3})
    again, header = load_baseline(tmp_path / "b.safetensors")
    assert header["seed"] == 3
    assert again.architecture == baseline.architecture
    assert torch.equal(again.decode(mean), drawn)
    states, velocities = again.rollout(mean, 0.1 * mean, torch.rand(3, 5, 8))
    assert states.shape == velocities.shape == (3, 5, 4)
    assert torch.equal(states[:, 0], mean)


def test_sides_that_cannot_be_halved_three_times_are_refused():
    with pytest.raises(ValueError, match="multiples of 8"):
        Baseline(architecture(height=20))
    with pytest.raises(ValueError, match="nodes of 2"):
        Baseline(architecture(d=5))


def test_the_velocity_is_the_derivative_of_the_mean():
    torch.manual_seed(0)
    encoder = Baseline(architecture()).encoder
    images, rates = torch.rand(2, 3, 16, 24), torch.randn(2, 3, 16, 24)
    mean, _, velocity = encoder.moving(images, rates)
    assert torch.equal(mean, encoder(images)[0])
    step = 1e-2
    ahead, behind = (encoder(images + sign * step * rates)[0] for sign in (1, -1))
    torch.testing.assert_close(velocity, (ahead - behind) / (2 * step), atol=2e-2, rtol=2e-2)


def test_delays_are_oldest_first_and_stay_in_their_clip():
    inputs = np.arange(12.0).reshape(6, 2)
    rows = stack_delays(inputs, samples=3, segments=[(0, 4), (4, 6)])
    assert rows[0].tolist() == [0, 1] * 3
    assert rows[2].tolist() == [0, 1, 2, 3, 4, 5]
    assert rows[4].tolist() == [8, 9] * 3


@pytest.mark.parametrize("paired", [True, False])
def test_oscillators_lose_energy_and_stand_still_at_rest(paired):
    torch.manual_seed(1)
    law = Oscillators(4, n_inputs=2, dt_s=1e-4, paired=paired).double()
    with torch.no_grad():
        for layer in law.force:
            layer.weight.zero_()
            layer.bias.zero_()
        stiffness, mass = law.stiffness(), 1 / law.inverse_mass()
        assert torch.equal(stiffness, stiffness.T)
        assert torch.linalg.eigvalsh(stiffness).min() > 0
        z, v = torch.randn(5, 4, dtype=torch.float64), torch.randn(5, 4, dtype=torch.float64)
        u = torch.zeros(5, 2, dtype=torch.float64)

        def energy(z, v):
            return 0.5 * (mass * v**2).sum(1) + 0.5 * torch.einsum("bi,ij,bj->b", z, stiffness, z)

        before = energy(z, v)
        matrix = torch.linalg.matrix_power(law.transition(), 300)
        expected = torch.cat([z, v], 1) @ matrix.T
        for _ in range(300):
            z, v = law(z, v, u)
        assert (energy(z, v) < before).all()
        torch.testing.assert_close(torch.cat([z, v], 1), expected)
        rest = law.rest.expand(1, 4).double()
        assert torch.equal(law(rest, 0 * rest, u[:1])[0], rest)


def test_a_push_accelerates_by_the_inverse_mass():
    law = Oscillators(4, n_inputs=2, dt_s=0.01, paired=True)
    z, u = torch.zeros(1, 4), torch.zeros(1, 2)
    push = torch.tensor([[0.0, 2.0, 0.0, 0.0]])
    gained = law(z, z, u, push)[1] - law(z, z, u)[1]
    torch.testing.assert_close(gained, 0.01 * law.inverse_mass() * push)


def test_koopman_is_one_matrix():
    law = Koopman(2, n_inputs=3)
    with torch.no_grad():
        law.matrix.normal_()
    z, v, u = torch.randn(2, 2), torch.randn(2, 2), torch.zeros(2, 3)
    expected = torch.cat([z, v], 1) @ law.transition().T + law.input_force(u)
    assert torch.equal(torch.cat(law(z, v, u), 1), expected)


def test_attention_sums_to_one_and_noise_is_drawn_only_where_asked():
    decoder = Baseline(architecture()).decoder
    z = torch.randn(2, 4)
    torch.testing.assert_close(decoder.logits(z).softmax(-1).sum(-1), torch.ones(2, 16 * 24))
    assert decoder.maps(z).shape == (2, 2, 16 * 24)
    generators = [torch.Generator().manual_seed(5) for _ in range(2)]
    noisy = [decoder(z, generator=generator) for generator in generators]
    assert torch.equal(*noisy)
    assert not torch.equal(noisy[0], decoder(z))


def test_centres_move_as_their_jacobian_says():
    torch.manual_seed(2)
    decoder = Baseline(architecture()).decoder.double()
    z, velocity = torch.randn(3, 4, dtype=torch.float64), torch.randn(3, 4, dtype=torch.float64)
    maps, rates = torch.func.jvp(decoder.maps, (z,), (velocity,))
    places, speeds = compute_moving_centres(maps, rates, decoder.places)
    torch.testing.assert_close(places, compute_attention_centres(maps, decoder.places))
    expected = torch.einsum("bgcd,bd->bgc", compute_centre_jacobian(decoder, z), velocity)
    torch.testing.assert_close(speeds, expected, atol=1e-8, rtol=1e-6)


def test_pairs_that_close_at_full_speed_rate_minus_one():
    points = torch.tensor([[[0.0, 0.0], [2.0, 0.0]]])
    velocities = torch.tensor([[[1.0, 0.0], [-1.0, 0.0]]])
    rates = compute_closing_rates(points, velocities)
    assert rates[0].tolist() == [[0.0, -1.0], [-1.0, 0.0]]
    assert measure_disagreement(rates, -rates) == 4.0
    assert compute_closing_rates(points, 0 * velocities).abs().max() == 0.0


def test_maps_may_change_only_where_the_image_does():
    still = torch.zeros(1, 3, 2, 2)
    still[0, :, 0, 0] = 3.0
    rates = torch.zeros(1, 1, 4)
    rates[0, 0, 0] = 5.0
    assert penalize_unwarranted_change(rates, still) < 1e-6
    rates[0, 0, 3] = -2.0
    assert penalize_unwarranted_change(rates, still) == pytest.approx(0.5)


def test_an_architecture_is_plain_data():
    assert BaselineArchitecture(**vars(architecture())) == architecture()
    assert architecture().dt_s == DT_S
