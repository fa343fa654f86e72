"""One state at a time against the batched law, whose formulas it repeats."""

import numpy as np
import pytest
import torch

from lagsplat.forces.batched_lagrangian import Single
from lagsplat.forces.loaded_lagrangian import LawEdits, LoadedLagrangian, rollout_under_force
from tests.stage2_problems import random_lagrangian

FORMS = [
    {},
    {"mass": "constant", "damping": "constant", "potential": "quadratic", "actuation": "linear"},
    {"potential": "icnn", "actuation": "concave"},
]


@pytest.mark.parametrize("d", [1, 2, 4])
@pytest.mark.parametrize("form", FORMS, ids=["default", "linear", "convex"])
@pytest.mark.parametrize("negative", [0.0, 1.0], ids=["one sign", "signed"])
def test_forces_and_accelerations_agree(d: int, form: dict, negative: float) -> None:
    law = random_lagrangian(d, 2, 3, negative=negative, **form)
    edits = LawEdits(damping=0.5, inertia=2.0, stiffness=1.5)
    q, v, load = torch.randn(3, 5, d, dtype=torch.float64)
    u = torch.rand(5, 2, dtype=torch.float64) - 0.5 * negative
    loaded = LoadedLagrangian(law, load, edits=edits)
    with torch.no_grad():
        expected = loaded.acceleration(q, v, u).numpy()
        force = loaded.conservative_force(q, u, loaded.prepare()).numpy() - load.numpy()
    single = Single(law, edits=edits)
    rows = [[x.numpy() for x in row] for row in zip(q, v, u, load, strict=True)]
    got = np.stack([single.acceleration(*row) for row in rows])
    np.testing.assert_allclose(got, expected, rtol=1e-6, atol=1e-7)
    own = np.stack([single.conservative_force(row[0], row[2]) for row in rows])
    np.testing.assert_allclose(own, force, rtol=1e-6, atol=1e-7)


@pytest.mark.parametrize("dt_s", [0.01, 0.04], ids=["one piece", "several"])
def test_steps_are_those_of_the_rollout(dt_s: float) -> None:
    law = random_lagrangian(2, 1, 5)
    law.longest_step = 0.25
    q0, v0, load = torch.randn(3, 1, 2, dtype=torch.float64)
    u = torch.rand(1, 1, dtype=torch.float64)
    expected = rollout_under_force(
        law, q0, v0, u[None].expand(1, 9, 1), load[None].expand(1, 9, 2), dt_s=dt_s
    )
    single, (q, v) = Single(law), (q0[0].numpy(), v0[0].numpy())
    for _ in range(3):
        q, v = single.step(q, v, u[0].numpy(), load[0].numpy(), dt_s=dt_s)
    np.testing.assert_allclose(q, expected[0][0, 3].numpy(), rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(v, expected[1][0, 3].numpy(), rtol=1e-6, atol=1e-7)


def test_a_mass_induced_by_the_decoder_is_refused() -> None:
    with pytest.raises(ValueError, match="induced"):
        Single(random_lagrangian(2, 1, 0, mass="induced"))
