"""What holds for forces on whatever the networks have learned."""

from dataclasses import replace

import numpy as np
import pytest
import torch
from hypothesis import example, given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize
from torch.autograd.functional import jacobian

from lagsplat.forces.grasp import grasp_brush
from lagsplat.forces.loaded_lagrangian import (
    LoadedLagrangian,
    find_loaded_equilibria,
    rollout_under_force,
)
from lagsplat.forces.loads import ConstantLoad, PointLoad, SummedLoad, make_no_load
from lagsplat.matter.body_motion import make_body_at_rest
from lagsplat.matter.field import MatterField
from lagsplat.matter.film_registration import list_pixels
from lagsplat.monomials import make_wide_ball
from lagsplat.stage2.equilibrium import NoEquilibriumError, compute_loaded_energy, find_equilibria
from lagsplat.stage2.lagrangian import Lagrangian, LawEdits
from lagsplat.stage2.rollout import rollout
from tests.stage2_problems import random_lagrangian

seeds = st.integers(0, 2**31 - 1)
dims = st.integers(1, 4)
sizes = st.sampled_from([1e-3, 1.0, 30.0, 1e4])
many = settings(max_examples=4, deadline=None)


def scene(d: int, generator: torch.Generator) -> MatterField:
    """Matter all over a picture of 20 by 10 px: a rigid body on the left, one that bends on the right."""
    pixels = list_pixels(10, 20)
    number = (pixels[:, 0] > 10.0).long()
    bodies = []
    for i, bending in enumerate((0, 2)):
        still = make_body_at_rest(pixels[number == i], make_wide_ball(d), bending=bending)
        still = still.with_latent_degree(2)
        noise = torch.randn(still.coefficients.shape, generator=generator, dtype=torch.float64)
        bodies.append(replace(still, coefficients=0.2 * noise))
    return MatterField(tuple(bodies), pixels, number)


def problem(d: int, seed: int, *, n_inputs: int = 1) -> tuple[Lagrangian, MatterField, torch.Tensor]:
    torch.manual_seed(seed)  # the loads and states that the tests draw themselves
    generator = torch.Generator().manual_seed(seed)
    u = torch.rand(1, n_inputs, generator=generator, dtype=torch.float64)
    return random_lagrangian(d, n_inputs, seed), scene(d, generator), u


def draw_load(matter: MatterField, d: int) -> PointLoad:
    """A force on the matter in the middle of the picture."""
    grip = grasp_brush(matter, torch.zeros(d, dtype=torch.float64), (9.0, 4.0), radius=2.0)
    return PointLoad(grip.points, torch.randn(1, 2, dtype=torch.float64))


@many
@given(seed=seeds, d=dims, size=sizes)
def test_a_held_force_is_balanced_where_the_energy_is_least(seed: int, d: int, size: float) -> None:
    law, _, u = problem(d, seed)
    load = ConstantLoad(size * torch.randn(5, d, dtype=torch.float64))
    q = find_loaded_equilibria(law, u.expand(5, -1), load)
    loaded = LoadedLagrangian(law, load)
    with torch.no_grad():
        left = loaded.conservative_force(q, u.expand(5, -1), loaded.prepare())
        least = compute_loaded_energy(loaded, q, u.expand(5, -1))
        around = torch.stack(
            [compute_loaded_energy(loaded, q + 0.05 * torch.randn(5, d), u.expand(5, -1)) for _ in range(9)]
        )
    assert float(left.norm(dim=1).max()) < 1e-7 * max(1.0, size)
    assert bool((around >= least - 1e-9 * least.abs()).all())


@many
@given(seed=seeds, d=dims)
def test_without_a_force_it_is_the_rest_state_under_the_inputs(seed: int, d: int) -> None:
    law, _, u = problem(d, seed)
    q = find_equilibria(law, u)

    def energy_and_slope(flat: np.ndarray) -> tuple[float, np.ndarray]:
        at = torch.from_numpy(flat)[None]
        with torch.no_grad():
            slope = -law.conservative_force(at, u, law.prepare())[0]
            return float(compute_loaded_energy(law, at, u)[0]), slope.numpy()

    found = minimize(energy_and_slope, law.rest.detach().numpy(), jac=True, options={"gtol": 1e-9})
    torch.testing.assert_close(q[0], torch.from_numpy(found.x), atol=1e-5, rtol=1e-5)
    where = find_equilibria(law, u, q[0])
    torch.testing.assert_close(where, q, atol=1e-12, rtol=1e-12)


@many
@given(seed=seeds, d=dims)
def test_the_force_is_the_slope_of_the_energy(seed: int, d: int) -> None:
    law, matter, u = problem(d, seed)
    loaded = LoadedLagrangian(law, draw_load(matter, d), edits=LawEdits(2.0, 3.0, 0.5))
    q = torch.randn(d, dtype=torch.float64)
    slope = jacobian(lambda x: compute_loaded_energy(loaded, x[None], u)[0], q)
    with torch.no_grad():
        force = loaded.conservative_force(q[None], u, loaded.prepare())[0]
    torch.testing.assert_close(force, -slope)


@many
@given(seed=seeds, d=dims)
def test_edits_scale_damping_inertia_and_stiffness(seed: int, d: int) -> None:
    law, _, u = problem(d, seed)
    q, v = torch.randn(2, 1, d, dtype=torch.float64)
    load, edits = torch.randn(1, d, dtype=torch.float64), LawEdits(damping=0.5, inertia=2.0, stiffness=3.0)
    loaded = LoadedLagrangian(law, ConstantLoad(load), edits=edits)
    with torch.no_grad():
        ready = law.prepare()
        elastic = law.conservative_force(q, torch.zeros_like(u), ready)
        pressed = law.conservative_force(q, u, ready) - elastic
        still = torch.zeros_like(v)
        curving = (
            law.mass(q) @ (law.acceleration(q, v, u) - law.acceleration(q, still, u))[:, :, None]
            + law.damping(q) @ v[:, :, None]
        )  # the velocity forces
        force = (3.0 * elastic + pressed + load)[:, :, None] - 0.5 * law.damping(q) @ v[:, :, None]
        expected = torch.linalg.solve(2.0 * law.mass(q), force + 2.0 * curving)[:, :, 0]
        torch.testing.assert_close(loaded.acceleration(q, v, u), expected)
        torch.testing.assert_close(loaded.mass(q), 2.0 * law.mass(q))
        torch.testing.assert_close(loaded.damping(q), 0.5 * law.damping(q))


@many
@given(seed=seeds, d=dims)
def test_under_a_held_force_energy_is_lost_as_fast_as_the_damping_takes_it(seed: int, d: int) -> None:
    law, matter, u = problem(d, seed)
    q, v = torch.randn(2, 1, d, dtype=torch.float64)
    loaded = LoadedLagrangian(law, draw_load(matter, d), edits=LawEdits(3.0, 2.0, 0.5))

    def total(q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
        return (
            0.5 * torch.einsum("bi,bij,bj->", v, loaded.mass(q), v)
            + compute_loaded_energy(loaded, q, u).sum()
        )

    by_q, by_v = jacobian(total, (q, v))
    with torch.no_grad():
        power = (by_q * v).sum() + (by_v * loaded.acceleration(q, v, u)).sum()
        lost = torch.einsum("bi,bij,bj->", v, loaded.damping(q), v)
    assert float(lost) > 0.0
    torch.testing.assert_close(power, -lost, rtol=1e-7, atol=1e-7 * float(by_q.norm() * v.norm()))


@many
@given(seed=seeds, d=dims)
def test_motion_without_a_force_is_the_law_s_own(seed: int, d: int) -> None:
    law, _, u = problem(d, seed)
    q0, v0 = torch.randn(2, 3, d, dtype=torch.float64)
    inputs = u.expand(20, -1).expand(3, -1, -1)
    free = rollout(law, q0, v0, inputs, dt_s=0.01)
    for got, expected in zip(
        rollout_under_force(law, q0, v0, inputs, [make_no_load(d)] * 19, dt_s=0.01),
        free,
        strict=True,
    ):
        torch.testing.assert_close(got, expected)


@many
@given(seed=seeds, d=dims)
def test_the_pulled_back_force_is_the_slope_of_its_work_and_adds_up(seed: int, d: int) -> None:
    _, matter, _ = problem(d, seed)
    q = 0.5 * torch.randn(d, dtype=torch.float64)
    grip = grasp_brush(matter, q, (9.0, 4.0), radius=2.0)
    force, other = torch.randn(2, 2, dtype=torch.float64)
    slope = jacobian(lambda x: force @ grip.place(x), q)
    torch.testing.assert_close(grip.place(q), grip.at)
    torch.testing.assert_close(grip.pull_back(force, q), slope)
    load = PointLoad(grip.points, force[None])
    torch.testing.assert_close(load.generalise(q[None])[0], slope)
    torch.testing.assert_close(jacobian(lambda x: load.work(x[None])[0], q), slope)
    both = SummedLoad((load, PointLoad(grip.points, other[None])))
    torch.testing.assert_close(
        both.generalise(q[None])[0], grip.pull_back(force + other, q), rtol=1e-12, atol=1e-12
    )


@many
@given(seed=seeds, d=dims)
@example(seed=20856, d=3)
def test_the_answer_does_not_depend_on_the_chart(seed: int, d: int) -> None:
    """The same kinematics and energy in bent coordinates ``q = psi(x)``, with a solver of another kind."""
    law, matter, u = problem(d, seed)
    generator = torch.Generator().manual_seed(seed)
    turn = torch.linalg.qr(torch.randn(d, d, generator=generator, dtype=torch.float64))[0]
    force = 0.1 * torch.tensor([0.4, -0.7], dtype=torch.float64)  # weak: stronger ones leave a choice of rest
    grip = grasp_brush(matter, torch.zeros(d, dtype=torch.float64), (9.0, 4.0), radius=2.0)
    q = find_loaded_equilibria(law, u, PointLoad(grip.points, force[None]))[0]

    def psi(x: torch.Tensor) -> torch.Tensor:
        return (x + 0.1 * x**3) @ turn * 1.7 + 0.2

    def work_and_slope(flat: np.ndarray) -> tuple[float, np.ndarray]:
        x = torch.from_numpy(flat)
        stretch = jacobian(psi, x)
        with torch.no_grad():
            elastic = law.conservative_force(psi(x)[None], u, law.prepare())[0] @ stretch
            value = compute_loaded_energy(law, psi(x)[None], u)[0] - force @ grip.place(psi(x))
        bent = grip.jacobian(psi(x)) @ stretch  # the Jacobian of the matter in the new chart
        return float(value), -(elastic + bent.T @ force).numpy()

    near = ((q - 0.2) / 1.7 @ turn.T).numpy()  # a law may rest elsewhere, too
    found = minimize(work_and_slope, near, jac=True, method="BFGS", options={"gtol": 1e-9})
    torch.testing.assert_close(psi(torch.from_numpy(found.x)), q, atol=1e-5, rtol=1e-5)


def test_a_force_that_is_not_finite_is_refused() -> None:
    with pytest.raises(ValueError, match="not finite"):
        ConstantLoad(torch.tensor([[torch.nan, 0.0]], dtype=torch.float64))


def test_a_force_beyond_the_numbers_is_refused_and_a_huge_one_is_answered() -> None:
    law, _, u = problem(2, 0)
    huge = find_loaded_equilibria(law, u, ConstantLoad(torch.full((1, 2), 1e8, dtype=torch.float64)))
    assert bool(torch.isfinite(huge).all())
    assert float(huge.norm()) > 1e6
    with pytest.raises(NoEquilibriumError, match="lower the force"):
        find_loaded_equilibria(law, u, ConstantLoad(torch.full((1, 2), 1e200, dtype=torch.float64)))
