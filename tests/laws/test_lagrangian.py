"""Laws that hold whatever the networks have learned."""

import numpy as np
import torch
from hypothesis import given, settings
from hypothesis import strategies as st
from scipy.optimize import minimize

from lagsplat.stage2.lagrangian import Coefficients, Lagrangian
from lagsplat.stage2.networks import factor_positive
from lagsplat.stage2.rollout import rollout, verlet_step
from tests.stage2_problems import random_lagrangian

seeds = st.integers(0, 2**31 - 1)
dims = st.integers(1, 4)
many = settings(max_examples=6, deadline=None)


def energy(lagrangian: Lagrangian, q: torch.Tensor, v: torch.Tensor) -> torch.Tensor:
    kinetic = 0.5 * torch.einsum("bi,bij,bj->b", v, lagrangian.mass(q), v)
    return (kinetic + lagrangian.potential(q)).detach()


@many
@given(seed=seeds, d=dims)
def test_mass_and_damping_stay_above_their_floors(seed: int, d: int) -> None:
    lagrangian = random_lagrangian(d, 1, seed)
    q = 5.0 * torch.randn(20, d, dtype=torch.float64)
    for matrix, floor in (
        (lagrangian.mass(q), lagrangian.floors.mass),
        (lagrangian.damping(q), lagrangian.floors.damping),
    ):
        torch.testing.assert_close(matrix, matrix.mT)
        assert float(torch.linalg.eigvalsh(matrix.detach()).min()) >= floor * (1 - 1e-6)


@many
@given(seed=seeds, d=dims)
def test_potential_is_zero_at_rest_and_grows_away_from_it(seed: int, d: int) -> None:
    lagrangian = random_lagrangian(d, 0, seed)
    rest = lagrangian.rest.detach()[None]
    assert abs(float(lagrangian.potential(rest).detach())) < 1e-12
    away = torch.randn(50, d, dtype=torch.float64)
    away = away / away.norm(dim=1, keepdim=True)
    # two residual blocks of Lipschitz constant 0.9 shrink a distance to no less than a hundredth
    for distance in (0.1, 10.0):
        bound = 0.5 * lagrangian.floors.stiffness * (0.01 * distance) ** 2
        assert float(lagrangian.potential(rest + distance * away).detach().min()) >= bound


@many
@given(seed=seeds, d=st.integers(1, 3), n_inputs=st.integers(0, 2))
def test_one_equilibrium_under_any_load(seed: int, d: int, n_inputs: int) -> None:
    lagrangian = random_lagrangian(d, n_inputs, seed)
    u = torch.rand(1, n_inputs, dtype=torch.float64)
    ready = lagrangian.prepare()

    def loaded(flat: np.ndarray) -> tuple[float, np.ndarray]:
        q = torch.from_numpy(flat)[None]
        with torch.no_grad():
            value = lagrangian.potential(q)[0] - (lagrangian.volume(q)[0] * u[0]).sum()
            return float(value), -lagrangian.conservative_force(q, u, ready)[0].numpy()

    rng = np.random.default_rng(seed)
    ends = [
        minimize(loaded, rng.normal(size=d) * 4, jac=True, method="BFGS", options={"gtol": 1e-8}).x
        for _ in range(4)
    ]
    np.testing.assert_allclose(ends, np.broadcast_to(ends[0], (4, d)), atol=1e-3)
    if n_inputs == 0:
        np.testing.assert_allclose(ends[0], lagrangian.rest.detach().numpy(), atol=1e-3)


@many
@given(seed=seeds, d=dims)
def test_volume_is_concave_along_straight_lines_of_the_straightened_chart(seed: int, d: int) -> None:
    lagrangian = random_lagrangian(d, 2, seed, potential="icnn", actuation="concave")
    a, b = torch.randn(2, 30, d, dtype=torch.float64)
    middle = lagrangian.volume(0.5 * (a + b))
    assert bool((middle >= 0.5 * (lagrangian.volume(a) + lagrangian.volume(b)) - 1e-12).all())


@many
@given(seed=seeds, d=dims)
def test_energy_balance(seed: int, d: int) -> None:
    """``dE/dt = u.(dnu/dt) - v.C v`` at any state, under any input."""
    lagrangian = random_lagrangian(d, 2, seed)
    q, v = torch.randn(2, 6, d, dtype=torch.float64)
    u = torch.rand(6, 2, dtype=torch.float64)
    a = lagrangian.acceleration(q, v, u).detach()
    h = 1e-5
    ahead, behind = (energy(lagrangian, q + s * v, v + s * a) for s in (h, -h))
    moved = (lagrangian.volume(q + h * v) - lagrangian.volume(q - h * v)).detach()
    power = (u * moved).sum(1) / (2 * h) - torch.einsum("bi,bij,bj->b", v, lagrangian.damping(q), v).detach()
    rate = (ahead - behind) / (2 * h)
    torch.testing.assert_close(rate, power, rtol=1e-4, atol=1e-4 * float(power.abs().max()))


@many
@given(seed=seeds, d=dims)
def test_energy_of_a_free_rollout_never_rises_beyond_the_order_of_the_step(seed: int, d: int) -> None:
    lagrangian = random_lagrangian(d, 0, seed, amount=0.1)
    q = 0.3 * torch.randn(4, d, dtype=torch.float64)
    unit = float(lagrangian.time_unit_s)
    rises = []
    for step in (0.02, 0.01):
        n = round(1.0 / step)
        path, speed = rollout(
            lagrangian, q, 0.0 * q, torch.zeros(4, n, 0, dtype=torch.float64), dt_s=step * unit
        )
        flat = energy(lagrangian, path.flatten(0, 1), unit * speed.flatten(0, 1)).view(4, n)
        rises.append(float((flat[:, 1:] - flat[:, :-1]).clamp(min=0).max() / flat.max()))
    assert rises[0] < 1e-3
    assert rises[1] <= 0.3 * rises[0] + 1e-9


@many
@given(seed=seeds)
def test_forecasts_do_not_depend_on_the_affine_chart(seed: int) -> None:
    """A constant system written in another affine chart makes the same forecast."""
    d, n_inputs = 3, 2
    lagrangian = random_lagrangian(
        d, n_inputs, seed, mass="constant", damping="constant", potential="quadratic", actuation="linear"
    )
    rng = torch.Generator().manual_seed(seed)
    change = torch.randn(d, d, generator=rng, dtype=torch.float64) + 3.0 * torch.eye(d, dtype=torch.float64)
    shift = torch.randn(d, generator=rng, dtype=torch.float64)
    q, v = torch.randn(2, 2, d, generator=rng, dtype=torch.float64)
    inputs = torch.rand(2, 20, n_inputs, generator=rng, dtype=torch.float64)
    path, _ = rollout(lagrangian, q, v, inputs, dt_s=0.005)
    # rows: x = q change + shift, hence every form is pulled back by the inverse
    back = torch.linalg.inv(change)
    moved = random_lagrangian(
        d, n_inputs, seed, mass="constant", damping="constant", potential="quadratic", actuation="linear"
    )
    with torch.no_grad():
        stiffness = lagrangian.prepare().stiffness
        for term, value in (
            (moved.mass_term, lagrangian.mass(q)[0]),
            (moved.damping_term, lagrangian.damping(q)[0]),
        ):
            term.floor = 1e-12
            term.factor.copy_(factor_positive(back @ value @ back.T, 1e-12))
        moved.floors = type(moved.floors)(1e-12, 1e-12, 1e-12)
        moved.stiffness_factor.copy_(factor_positive(back @ stiffness @ back.T, 1e-12))
        moved.pressure_map.copy_(lagrangian.pressure_map @ back.T)
        moved.rest.copy_(lagrangian.rest @ change + shift)
    again, _ = rollout(moved, q @ change + shift, v @ change, inputs, dt_s=0.005)
    torch.testing.assert_close(again, path @ change + shift, rtol=1e-6, atol=1e-6)


def test_silent_networks_leave_the_start_as_it_is() -> None:
    """Before training, the full form and the constant form are the same system."""
    eye = torch.eye(2, dtype=torch.float64)
    start = Coefficients(2 * eye, 0.2 * eye, 3 * eye, torch.ones(1, 2, dtype=torch.float64), eye[0])
    full, flat = (
        random_lagrangian(2, 1, 0, start=start, amount=0.0, **changes)
        for changes in (
            {},
            {"mass": "constant", "damping": "constant", "potential": "quadratic", "actuation": "linear"},
        )
    )
    q, v = torch.randn(2, 5, 2, dtype=torch.float64)
    u = torch.rand(5, 1, dtype=torch.float64)
    for lagrangian in (full, flat):
        torch.testing.assert_close(lagrangian.mass(q)[0], 2 * eye)
    got, want = (verlet_step(x, q, v, u, step=0.1, ready=x.prepare())[0] for x in (full, flat))
    torch.testing.assert_close(got, want)


@many
@given(seed=seeds, d=st.integers(1, 3))
def test_polynomial_laws_lose_energy_and_stay_bounded(seed: int, d: int) -> None:
    lagrangian = random_lagrangian(d, 0, seed, amount=0.2, terms="polynomial", map_degree=2)
    with torch.no_grad():  # a map of any coefficients would fold
        lagrangian.coordinates.coefficients.mul_(0.05)
    lagrangian.longest_step = 0.02
    generator = torch.Generator().manual_seed(seed)
    q, v = torch.randn(2, 3, d, dtype=torch.float64, generator=generator)
    unit = float(lagrangian.time_unit_s)
    path, speed = rollout(lagrangian, q, v / unit, torch.zeros(3, 60, 0), dt_s=0.1 * unit)
    levels = torch.stack([energy(lagrangian, x, w * unit) for x, w in zip(path, speed, strict=True)])
    rise = (levels[:, 1:] - levels[:, :-1]).max()
    assert float(rise) <= 1e-4 * float(levels.abs().max())
