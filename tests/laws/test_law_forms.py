"""What each form of the law promises, in torch and in arrays: slopes, energies, equilibria, edits."""

import math

import numpy as np
import pytest
import torch
from torch.autograd.functional import jacobian

from lagsplat.monomials import enclose_states
from lagsplat.stage2.equilibrium import (
    find_equilibrium,
    linearize_modes,
    list_stable_equilibria,
    move_rest_to_equilibrium,
)
from lagsplat.stage2.lagrangian import Coefficients, Floors, Lagrangian, LawEdits
from lagsplat.stage2.numpy_lagrangian import NumpyLagrangian
from tests.stage2_problems import form, random_lagrangian

FORMS = {
    "networks": {},
    "convex": {"potential": "icnn", "actuation": "concave"},
    "linear": {"mass": "constant", "damping": "constant", "potential": "quadratic", "actuation": "linear"},
    "polynomial": {"terms": "polynomial", "map_degree": 2, "matrix_degree": 1, "potential_degree": 4},
}
EVERY = pytest.mark.parametrize("name", FORMS)
EDITS = LawEdits(damping=0.5, inertia=2.0, stiffness=1.5)


def law_of(name: str, *, d: int = 2, n_inputs: int = 2, negative: float = 0.0) -> Lagrangian:
    law = random_lagrangian(d, n_inputs, 3, negative=negative, amount=0.2, **FORMS[name])
    if law.coordinates is not None:
        with torch.no_grad():  # a map of any coefficients would fold
            law.coordinates.coefficients.mul_(0.05)
    return law


def states(d: int = 2, n: int = 4) -> tuple[torch.Tensor, torch.Tensor]:
    q, v = torch.randn(2, n, d, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    return q, v


@EVERY
@pytest.mark.parametrize("negative", [0.0, 1.0])
def test_the_force_is_the_slope_of_potential_and_volumes(name: str, negative: float) -> None:
    law, (q, _) = law_of(name, negative=negative), states()
    u = torch.tensor([[0.7, 0.2], [0.1, 0.9], [0.0, 0.5], [0.4, 0.0]], dtype=torch.float64)
    u = u * torch.tensor([1.0, 1.0 - 2.0 * negative], dtype=torch.float64)

    def loaded(x: torch.Tensor) -> torch.Tensor:
        return (law.potential(x) - (law.volume(x, u) * u).sum(1)).sum()

    force = law.conservative_force(q, u, law.prepare()).detach()
    torch.testing.assert_close(force, -jacobian(loaded, q))


@EVERY
def test_the_law_in_arrays_has_the_energies_and_forces_of_the_law(name: str) -> None:
    law, (q, v) = law_of(name), states()
    arrays, unit = NumpyLagrangian(law, edits=EDITS), float(law.time_unit_s)
    u = torch.rand(4, 2, dtype=torch.float64)
    with torch.no_grad():
        kinetic = 0.5 * torch.einsum("bi,bij,bj->b", v, law.mass(q), v)
        lost = torch.einsum("bi,bij,bj->b", v, law.damping(q), v)
        elastic = law.conservative_force(q, torch.zeros_like(u), law.prepare())
        push = law.conservative_force(q, u, law.prepare()) - elastic
        resisted = law.resist(q, v)
        wanted = law.accelerate(q, v, (1.5 * elastic + push - 0.5 * resisted) / 2.0)
        potential = law.potential(q)
    args = q.numpy(), v.numpy() / unit
    close = {"rtol": 1e-8, "atol": 1e-9}
    np.testing.assert_allclose(arrays.kinetic(*args), 2.0 * kinetic, **close)
    np.testing.assert_allclose(arrays.dissipated_power(*args), 0.5 * lost / unit, **close)
    np.testing.assert_allclose(arrays.potential(q.numpy()), 1.5 * potential, **close)
    np.testing.assert_allclose(arrays.conservative_force(q.numpy(), u.numpy()), 1.5 * elastic + push, **close)
    np.testing.assert_allclose(arrays.acceleration(q.numpy(), v.numpy(), u.numpy()), wanted, **close)
    rest = law.rest.detach().numpy()
    assert arrays.potential(rest) == pytest.approx(0.0, abs=1e-12)


@EVERY
def test_energy_in_arrays_falls_by_what_is_dissipated(name: str) -> None:
    """``dE/dt = u.(dnu/dt) - c v.C v`` along a step that is short."""
    law, (q, v) = law_of(name), states(n=1)
    arrays, unit = NumpyLagrangian(law, edits=EDITS), float(law.time_unit_s)
    x, w, u = q[0].numpy(), 0.3 * v[0].numpy() / unit, np.array([0.6, 0.3])
    h = 1e-5 * unit
    energies, volumes = [], []
    for dt_s in (-h, h):
        at, speed = arrays.step(x, w, u, dt_s=dt_s)
        energies.append(float(arrays.potential(at) + arrays.kinetic(at, speed)))
        volumes.append(law.volume(torch.from_numpy(at)[None]).detach().numpy()[0] @ u)
    rate = (energies[1] - energies[0]) / (2.0 * h)
    power = (volumes[1] - volumes[0]) / (2.0 * h) - float(arrays.dissipated_power(x, w))
    assert rate == pytest.approx(power, rel=1e-4, abs=1e-5 * abs(energies[1]) / unit)


@pytest.mark.parametrize("name", ["networks", "polynomial"])
def test_a_step_in_arrays_is_of_its_integrators_order(name: str) -> None:
    """Verlet's error falls by four and Runge-Kutta's by sixteen or more where steps are halved."""
    law, (q, v) = law_of(name), states(n=1)
    law.longest_step = math.inf
    arrays, unit = NumpyLagrangian(law), float(law.time_unit_s)

    def end(steps: int) -> np.ndarray:
        x, w = q[0].numpy(), 0.3 * v[0].numpy() / unit
        for _ in range(steps):
            x, w = arrays.step(x, w, np.array([0.6, 0.3]), dt_s=0.4 * unit / steps)
        return x

    exact = end(256)
    coarse, fine = (np.abs(end(n) - exact).max() for n in (8, 16))
    assert coarse / fine > (3.0 if arrays.integrator == "verlet" else 12.0)
    arrays.longest_step = 0.05 + 1e-9
    np.testing.assert_allclose(end(1), end(8), rtol=1e-12)


def double_well(stiffness: float = -1.0) -> Lagrangian:
    """``V = -q^2/2 + q^4/4`` under a force equal to the input: wells at -1 and 1."""
    law = random_lagrangian(1, 1, 0, amount=0.0, terms="polynomial", potential_degree=4)
    with torch.no_grad():
        energy, _, _ = law.polynomials
        degrees = energy.exponents[:, 0].tolist()
        energy.coefficients.copy_(
            torch.tensor([{2: stiffness / 2.0, 4: 0.25}.get(n, 0.0) for n in degrees], dtype=torch.float64)
        )
        inputs = energy.input_exponents[:, 0].tolist()
        energy.input_coefficients.copy_(
            torch.tensor([[1.0 if n == 1 else 0.0 for n in inputs]], dtype=torch.float64)
        )
    return law


def test_both_wells_of_a_double_well_are_found_and_the_hill_is_not() -> None:
    law = double_well()
    tilt = torch.tensor([[0.0], [2.0]], dtype=torch.float64)
    both, one = list_stable_equilibria(law, tilt)
    np.testing.assert_allclose(sorted(both[:, 0].tolist()), [-1.0, 1.0], atol=1e-6)
    # q^3 - q = 2 has one root
    (root,) = [r.real for r in np.roots([1.0, 0.0, -1.0, -2.0]) if abs(r.imag) < 1e-9]
    np.testing.assert_allclose(one.numpy(), [[root]], atol=1e-6)


def test_equilibria_are_found_from_where_one_is() -> None:
    law, none = double_well(), torch.zeros(1, dtype=torch.float64)
    for near in (-0.5, 0.5):
        found = find_equilibrium(law, none, torch.tensor([near], dtype=torch.float64))
        assert found.item() == pytest.approx(2.0 * near, abs=1e-6)
    law.rest.data.fill_(0.7)
    move_rest_to_equilibrium(law)
    assert law.rest.item() == pytest.approx(1.0, abs=1e-6)
    assert law.potential(torch.ones(1, 1, dtype=torch.float64)).item() == pytest.approx(0.0, abs=1e-9)
    assert law.potential(torch.zeros(1, 1, dtype=torch.float64)).item() == pytest.approx(0.25, abs=1e-6)


def test_modes_are_those_of_the_well_they_are_in() -> None:
    """At 1 the curvature of the double well is 2; mass and damping are constant."""
    law, unit = double_well(), 0.1
    at = torch.ones(1, 1, dtype=torch.float64)
    mass, damping = law.mass(at).item(), law.damping(at).item()
    found = linearize_modes(law, torch.zeros(1, dtype=torch.float64), at[0])
    decay = damping / (2.0 * mass) / unit
    omega = math.sqrt(2.0 / mass / unit**2 - decay**2)
    assert found.decay_per_s == pytest.approx([decay], rel=1e-5)
    assert found.frequency_hz == pytest.approx([omega / (2.0 * math.pi)], rel=1e-5)


def test_an_overdamped_law_has_two_modes_of_no_frequency_the_slow_one_last() -> None:
    def one(x: float) -> torch.Tensor:
        return torch.tensor([[x]], dtype=torch.float64)

    none = torch.zeros(1, dtype=torch.float64)
    start = Coefficients(one(1.0), one(3.0), one(2.0), none.expand(0, 1), none)
    law = random_lagrangian(1, 0, 0, start=start, amount=0.0, **FORMS["linear"])
    found = linearize_modes(law, torch.zeros(0, dtype=torch.float64))
    assert found.frequency_hz == pytest.approx([0.0, 0.0])
    assert sorted(found.decay_per_s) == pytest.approx([10.0, 20.0])  # s^2 + 3 s + 2 in units of 0.1 s


@pytest.mark.parametrize("term", ["damping", "inertia", "stiffness"])
@pytest.mark.parametrize("value", [-1.0, math.inf, math.nan, 0.0])
def test_an_edit_is_a_positive_number_and_only_damping_may_be_none(term: str, value: float) -> None:
    if (term, value) == ("damping", 0.0):
        assert LawEdits(damping=0.0).damping == 0.0
        return
    with pytest.raises(ValueError, match=f"edit {term}=.*must be a positive number"):
        LawEdits(**{term: value})


def test_a_law_of_networks_has_no_polynomials() -> None:
    with pytest.raises(TypeError, match="no polynomials"):
        _ = law_of("networks").polynomials


def test_in_its_own_coordinates_a_law_has_no_map_and_is_at_rest_where_it_was() -> None:
    law, (q, _) = law_of("polynomial"), states()
    own = law.in_own_coordinates()
    assert law.coordinates is not None
    x, slope = law.coordinates.evaluate(q)
    torch.testing.assert_close(own.potential(x), law.potential(q))
    torch.testing.assert_close(slope.mT @ own.mass(x) @ slope, law.mass(q))
    torch.testing.assert_close(own.rest, law.coordinates.evaluate(law.rest[None])[0][0])
    plain = law_of("networks")
    assert plain.in_own_coordinates() is plain


def test_polynomials_are_free_where_the_map_takes_the_data() -> None:
    law, (q, _) = law_of("polynomial"), states(n=30)
    assert law.coordinates is not None
    law.move_ball(q)
    energy, mass, damping = law.polynomials
    wanted = enclose_states(law.coordinates.evaluate(q)[0].detach())
    for ball in (energy.ball, mass.frame.ball, damping.frame.ball):
        torch.testing.assert_close(ball, wanted)


@pytest.mark.parametrize(
    ("terms", "asked", "got"),
    [
        ("networks", "verlet", "verlet"),
        ("networks", "runge_kutta", "runge_kutta"),
        ("polynomial", "verlet", "runge_kutta"),
    ],
)
def test_polynomials_are_always_integrated_by_runge_kutta(terms: str, asked: str, got: str) -> None:
    eye = torch.eye(2, dtype=torch.float64)
    start = Coefficients(eye, eye, eye, torch.zeros(0, 2, dtype=torch.float64), eye[0])
    floors = Floors(0.01, 0.01, 0.01)
    law = Lagrangian(start, form=form(terms=terms), floors=floors, time_unit_s=0.1, seed=0, integrator=asked)
    assert law.integrator == got
    assert not law.signed


def test_an_induced_mass_needs_the_decoder() -> None:
    eye = torch.eye(2, dtype=torch.float64)
    start = Coefficients(eye, eye, eye, torch.zeros(0, 2, dtype=torch.float64), eye[0])
    with pytest.raises(ValueError, match="'induced' needs the decoder's geometry; pass geometry="):
        Lagrangian(start, form=form(mass="induced"), floors=Floors(0.1, 0.1, 0.1), time_unit_s=0.1, seed=0)


def test_signed_inputs_need_networks_for_their_volumes() -> None:
    eye = torch.eye(1, dtype=torch.float64)
    for n_inputs, actuation, signed in ((1, "bounded", True), (1, "linear", False), (0, "bounded", False)):
        start = Coefficients(eye, eye, eye, torch.ones(n_inputs, 1, dtype=torch.float64), eye[0])
        law = Lagrangian(
            start,
            form=form(actuation=actuation),
            floors=Floors(0.1, 0.1, 0.1),
            time_unit_s=1.0,
            seed=0,
            signed=True,
        )
        assert law.signed is signed


def test_a_rest_that_is_not_learned_stays() -> None:
    assert random_lagrangian(1, 0, 0).rest.requires_grad
    assert not random_lagrangian(1, 0, 0, rest="fixed").rest.requires_grad
