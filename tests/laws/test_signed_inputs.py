"""Inputs of either sign (torques, currents) leave the mechanism one bounded potential."""

from pathlib import Path

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from torch.autograd.functional import jacobian

from lagsplat.stage2.fit import load_dynamics, save_dynamics
from lagsplat.stage2.input_stiffness import measure_input_range
from lagsplat.stage2.lagrangian import Lagrangian
from tests.stage2_problems import random_lagrangian

problems = {
    "seed": st.integers(0, 2**31 - 1),
    "d": st.integers(1, 3),
    "n_inputs": st.integers(1, 2),
    "actuation": st.sampled_from(["bounded", "concave"]),
}
many = settings(max_examples=20, deadline=None)
LARGEST = 0.7
"""Of the negative inputs; of the positive ones it is 1."""


def signed(seed: int, d: int, n_inputs: int, **changes: str) -> tuple[Lagrangian, torch.Tensor]:
    """A Lagrangian, and loads within its reach, the corners among them."""
    lagrangian = random_lagrangian(d, n_inputs, seed, negative=LARGEST, potential="icnn", **changes)
    rng = torch.Generator().manual_seed(seed)
    inner = torch.rand(4, n_inputs, generator=rng, dtype=torch.float64) * (1 + LARGEST) - LARGEST
    ends = torch.tensor([-LARGEST, 1.0], dtype=torch.float64)
    corners = torch.cartesian_prod(*[ends] * n_inputs).view(-1, n_inputs)
    return lagrangian, torch.cat([inner, corners])


def loaded(lagrangian: Lagrangian, q: torch.Tensor, u: torch.Tensor) -> torch.Tensor:
    wide = u.expand(len(q), -1)
    return (lagrangian.potential(q) - (lagrangian.volume(q, wide) * wide).sum(1)).detach()


@many
@given(**problems)
def test_stiffness_stays_above_its_floor_under_any_load(
    seed: int, d: int, n_inputs: int, actuation: str
) -> None:
    lagrangian, loads = signed(seed, d, n_inputs, actuation=actuation)
    ready = lagrangian.prepare()
    for q in (lagrangian.rest.detach(), torch.randn(d, dtype=torch.float64)):
        for u in loads:
            force = jacobian(lambda x, u=u: lagrangian.conservative_force(x[None], u[None], ready)[0], q)
            assert float(torch.linalg.eigvalsh(-force).min()) >= lagrangian.floors.stiffness * (1 - 1e-6)


@many
@given(**problems)
def test_energy_under_a_load_is_convex_along_every_ray_and_rises_in_the_end(
    seed: int, d: int, n_inputs: int, actuation: str
) -> None:
    lagrangian, loads = signed(seed, d, n_inputs, actuation=actuation)
    away = torch.randn(d, dtype=torch.float64)
    ray = torch.linspace(0, 1e4, 41, dtype=torch.float64)[:, None] * (away / away.norm())
    for u in loads:
        energy = loaded(lagrangian, lagrangian.rest.detach() + ray, u)
        input_stiffness = energy[2:] - 2 * energy[1:-1] + energy[:-2]
        assert float(input_stiffness.min()) > 0
        assert float(energy[-1]) > float(energy[0])


@many
@given(**problems)
def test_the_force_is_the_slope_of_the_loaded_energy(
    seed: int, d: int, n_inputs: int, actuation: str
) -> None:
    lagrangian, loads = signed(seed, d, n_inputs, actuation=actuation)
    q, h = torch.randn(1, d, dtype=torch.float64), 1e-5
    for u in loads:
        slope = torch.stack(
            [
                (loaded(lagrangian, q + h * e, u) - loaded(lagrangian, q - h * e, u))[0] / (2 * h)
                for e in torch.eye(d, dtype=torch.float64)
            ]
        )
        force = lagrangian.conservative_force(q, u[None], lagrangian.prepare())[0].detach()
        torch.testing.assert_close(force, -slope, rtol=1e-5, atol=1e-5)


def test_an_input_of_one_sign_gives_the_same_law_and_the_same_file(tmp_path: Path) -> None:
    for negative, name in ((0.0, "one"), (LARGEST, "both")):
        lagrangian = random_lagrangian(2, 2, 0, negative=negative)
        assert lagrangian.signed == (negative > 0)
        save_dynamics(tmp_path / name, lagrangian, {})
        again, header = load_dynamics(tmp_path / name)
        assert ("signed" in header["dynamics"]) == lagrangian.signed
        assert ("curvature.largest_negative" in lagrangian.state_dict()) == lagrangian.signed
        q, u = (
            torch.randn(5, 2, dtype=torch.float64),
            torch.linspace(-0.5, 1, 5)[:, None].double().expand(5, 2),
        )
        for law in (lagrangian, again):
            law.eval()
        assert torch.equal(lagrangian.acceleration(q, q, u), again.acceleration(q, q, u))


def test_what_counts_as_signed() -> None:
    inputs = np.array([[0.0, -1.0, -0.004, -3.0], [2.0, 0.5, 1.0, -1.0]])
    input_range = measure_input_range(inputs)
    np.testing.assert_array_equal(input_range.positive, [2.0, 0.5, 1.0, 0.0])
    np.testing.assert_array_equal(input_range.negative, [0.0, 1.0, 0.0, 3.0])
    assert input_range.signed
    assert not measure_input_range(inputs[:, [0, 2]]).signed
    assert not measure_input_range(np.zeros((3, 0))).signed
