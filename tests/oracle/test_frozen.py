"""The frozen law against the torch one it was taken from."""

import numpy as np
import pytest
import torch

from lagsplat.stage2.numpy_lagrangian import FrozenLaw, roll_out_free
from lagsplat.stage2.rollout import rollout
from tests.stage2_problems import random_lagrangian

PLAIN = {"mass": "constant", "damping": "constant", "potential": "quadratic", "actuation": "linear"}


@pytest.mark.parametrize(
    ("d", "n_inputs", "changes"),
    [
        (1, 0, {}),
        (3, 2, {}),
        (2, 1, {"potential": "icnn"}),
        (1, 0, {"mass": "constant"}),
        (2, 0, PLAIN),
    ],
)
def test_a_frozen_law_accelerates_as_the_learned_one(d: int, n_inputs: int, changes: dict) -> None:
    lagrangian = random_lagrangian(d, n_inputs, 3, **changes)
    law = FrozenLaw(lagrangian)
    q, v, force = torch.randn(3, 7, d, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    still = torch.zeros(7, n_inputs, dtype=torch.float64)
    ready = lagrangian.prepare()
    with torch.no_grad():
        wanted = lagrangian.acceleration(q, v, still, ready=ready).numpy()
        slope = -lagrangian.conservative_force(q, still, ready).numpy()
        pushed = np.linalg.solve(lagrangian.mass(q).numpy(), force.numpy()[:, :, None])[:, :, 0]
    np.testing.assert_allclose(law.acceleration(q.numpy(), v.numpy()), wanted, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(law.slope_of_potential(q.numpy()), slope, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(
        law.acceleration(q.numpy(), v.numpy(), force.numpy()), wanted + pushed, rtol=1e-9, atol=1e-9
    )


def test_its_rollouts_are_those_of_the_learned_law_in_pieces_too() -> None:
    lagrangian = random_lagrangian(2, 0, 5)
    lagrangian.longest_step = 0.1
    q, v = torch.randn(2, 3, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    wanted, speeds = rollout(lagrangian, q, v, torch.zeros(3, 40, 0), dt_s=0.025)
    found, velocities = roll_out_free(FrozenLaw(lagrangian), q.numpy(), v.numpy(), states=40, dt_s=0.025)
    np.testing.assert_allclose(found, wanted.numpy(), rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(velocities, speeds.numpy(), rtol=1e-7, atol=1e-8)


def test_what_blows_up_is_not_finite_and_nothing_is_raised() -> None:
    lagrangian = random_lagrangian(1, 0, 5)
    path, _ = roll_out_free(
        FrozenLaw(lagrangian), np.ones((1, 1)), np.full((1, 1), 1e6), states=300, dt_s=30.0
    )
    assert path.shape == (1, 300, 1)


def test_an_induced_mass_is_refused() -> None:
    with pytest.raises(ValueError, match="decoder-induced"):
        FrozenLaw(random_lagrangian(2, 0, 1, mass="induced"))
