"""The learned law in NumPy against the torch one: accelerations, rollouts, energies."""

import numpy as np
import pytest
import torch

from lagsplat.forces.loaded_lagrangian import (
    LoadedLagrangian,
    TorchLagrangian,
    make_fast_lagrangian,
    rollout_under_force,
)
from lagsplat.forces.loads import ConstantLoad, make_no_load
from lagsplat.monomials import draw_states, make_wide_ball
from lagsplat.stage2.lagrangian import Lagrangian, LawEdits
from lagsplat.stage2.numpy_lagrangian import NumpyLagrangian, roll_out_free
from lagsplat.stage2.rollout import rollout
from tests.stage2_problems import random_lagrangian

PLAIN = {"mass": "constant", "damping": "constant", "potential": "quadratic", "actuation": "linear"}


def compare_with_torch(lagrangian: Lagrangian, *, scale: float = 1.0) -> None:
    """Accelerations with and without a force, and conservative forces, at random states of that size."""
    law, d = NumpyLagrangian(lagrangian), lagrangian.d
    draws = torch.randn(3, 7, d, dtype=torch.float64, generator=torch.Generator().manual_seed(1))
    q, v, force = scale * draws[0], draws[1], draws[2]
    still = torch.zeros(7, lagrangian.n_inputs, dtype=torch.float64)
    ready = lagrangian.prepare()
    with torch.no_grad():
        wanted = lagrangian.acceleration(q, v, still, ready=ready).numpy()
        slope = -lagrangian.conservative_force(q, still, ready).numpy()
        pushed = np.linalg.solve(lagrangian.mass(q).numpy(), force.numpy()[:, :, None])[:, :, 0]
    np.testing.assert_allclose(law.acceleration(q.numpy(), v.numpy()), wanted, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(-law.conservative_force(q.numpy()), slope, rtol=1e-9, atol=1e-9)
    np.testing.assert_allclose(
        law.acceleration(q.numpy(), v.numpy(), None, force.numpy()), wanted + pushed, rtol=1e-9, atol=1e-9
    )


@pytest.mark.parametrize(
    ("d", "n_inputs", "changes"),
    [
        (1, 0, {}),
        (3, 2, {}),
        (2, 1, {"potential": "icnn"}),
        (1, 0, {"mass": "constant"}),
        (2, 0, PLAIN),
        (1, 0, {"terms": "polynomial"}),
        (3, 2, {"terms": "polynomial"}),
    ],
)
def test_a_batch_accelerates_as_the_torch_law(d: int, n_inputs: int, changes: dict) -> None:
    compare_with_torch(random_lagrangian(d, n_inputs, 3, **changes))


@pytest.mark.parametrize("scale", [0.2, 1.0, 5.0])  # within the recorded range, about its edge, far outside
@pytest.mark.parametrize(("d", "n_inputs"), [(1, 0), (3, 2)])
def test_polynomials_are_clipped_as_those_of_the_torch_law(d: int, n_inputs: int, scale: float) -> None:
    lagrangian = random_lagrangian(d, n_inputs, 3, terms="polynomial")
    lagrangian.move_ball(draw_states(make_wide_ball(d, 1.0), 300, reach=1.0, seed=2))
    compare_with_torch(lagrangian, scale=scale)


@pytest.mark.parametrize("terms", ["networks", "polynomial"])
def test_its_rollouts_are_those_of_the_learned_law_in_pieces_too(terms: str) -> None:
    lagrangian = random_lagrangian(2, 0, 5, terms=terms)
    lagrangian.longest_step = 0.1
    q, v = torch.randn(2, 3, 2, dtype=torch.float64, generator=torch.Generator().manual_seed(2))
    wanted, speeds = rollout(lagrangian, q, v, torch.zeros(3, 40, 0), dt_s=0.025)
    found, velocities = roll_out_free(
        NumpyLagrangian(lagrangian), q.numpy(), v.numpy(), states=40, dt_s=0.025
    )
    np.testing.assert_allclose(found, wanted.numpy(), rtol=1e-8, atol=1e-9)
    np.testing.assert_allclose(velocities, speeds.numpy(), rtol=1e-7, atol=1e-8)


def test_what_blows_up_is_not_finite_and_nothing_is_raised() -> None:
    lagrangian = random_lagrangian(1, 0, 5)
    path, _ = roll_out_free(
        NumpyLagrangian(lagrangian), np.ones((1, 1)), np.full((1, 1), 1e6), states=300, dt_s=30.0
    )
    assert path.shape == (1, 300, 1)


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
    loaded = LoadedLagrangian(law, ConstantLoad(load), edits=edits)
    with torch.no_grad():
        expected = loaded.acceleration(q, v, u).numpy()
        force = loaded.conservative_force(q, u, loaded.prepare()).numpy() - load.numpy()
    single = NumpyLagrangian(law, edits=edits)
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
    expected = rollout_under_force(law, q0, v0, u[None].expand(1, 9, 1), [ConstantLoad(load)] * 8, dt_s=dt_s)
    single, (q, v) = NumpyLagrangian(law), (q0[0].numpy(), v0[0].numpy())
    for _ in range(3):
        q, v = single.step(q, v, u[0].numpy(), load[0].numpy(), dt_s=dt_s)
    np.testing.assert_allclose(q, expected[0][0, 3].numpy(), rtol=1e-6, atol=1e-7)
    np.testing.assert_allclose(v, expected[1][0, 3].numpy(), rtol=1e-6, atol=1e-7)


def test_a_mass_induced_by_the_decoder_is_refused() -> None:
    with pytest.raises(ValueError, match="induced"):
        NumpyLagrangian(random_lagrangian(2, 1, 0, mass="induced"))


EDITS = LawEdits(damping=0.5, inertia=2.0, stiffness=1.5)
LAW_FORMS = [{}, {"mass": "constant", "potential": "quadratic", "actuation": "linear"}, {"potential": "icnn"}]


@pytest.mark.parametrize("form", LAW_FORMS, ids=["default", "linear", "convex"])
def test_energies_are_those_of_the_law(form: dict) -> None:
    law = random_lagrangian(2, 1, 3, **form)
    law.time_unit_s.fill_(0.2)
    single, loaded = (
        NumpyLagrangian(law, edits=EDITS),
        LoadedLagrangian(law, make_no_load(2), edits=EDITS),
    )
    q, v = torch.randn(2, 4, 2, dtype=torch.float64)
    w = 0.2 * v
    with torch.no_grad():
        kinetic = 0.5 * torch.einsum("bi,bij,bj->b", w, loaded.mass(q), w)
        taken = torch.einsum("bi,bij,bj->b", w, loaded.damping(q), w) / 0.2
        elastic = loaded.potential(q)
    rows = [(a.numpy(), b.numpy()) for a, b in zip(q, v, strict=True)]
    np.testing.assert_allclose([single.kinetic(*row) for row in rows], kinetic, rtol=1e-6)
    np.testing.assert_allclose([single.dissipated_power(*row) for row in rows], taken, rtol=1e-6)
    np.testing.assert_allclose([single.potential(a) for a, _ in rows], elastic, rtol=1e-6, atol=1e-9)


def test_tensors_and_arrays_step_alike() -> None:
    law = random_lagrangian(2, 1, 3)
    one, two = NumpyLagrangian(law, edits=EDITS), TorchLagrangian(law, edits=EDITS)
    q, v, load = np.random.default_rng(0).normal(size=(3, 2))
    u = np.array([0.4])
    for got, wanted in zip(
        one.step(q, v, u, load, dt_s=0.01), two.step(q, v, u, load, dt_s=0.01), strict=True
    ):
        np.testing.assert_allclose(got, wanted, rtol=1e-6)
    assert one.kinetic(q, v) == pytest.approx(two.kinetic(q, v), rel=1e-6)
    assert one.potential(q) == pytest.approx(two.potential(q), rel=1e-6)
    assert one.dissipated_power(q, v) == pytest.approx(two.dissipated_power(q, v), rel=1e-6)
    np.testing.assert_allclose(one.conservative_force(q, u), two.conservative_force(q, u), rtol=1e-6)


def test_the_form_follows_the_mass() -> None:
    assert isinstance(make_fast_lagrangian(random_lagrangian(2, 1, 0)), NumpyLagrangian)
    assert isinstance(make_fast_lagrangian(random_lagrangian(2, 1, 0, mass="induced")), TorchLagrangian)
