"""Energies of one state against the batched law, and the two forms of a stepper against each other."""

import numpy as np
import pytest
import torch

from lagsplat.forces.batched_lagrangian import Batched, Single, open_stepper
from lagsplat.forces.loaded_lagrangian import LawEdits, LoadedLagrangian
from tests.stage2_problems import random_lagrangian

EDITS = LawEdits(damping=0.5, inertia=2.0, stiffness=1.5)
FORMS = [{}, {"mass": "constant", "potential": "quadratic", "actuation": "linear"}, {"potential": "icnn"}]


@pytest.mark.parametrize("form", FORMS, ids=["default", "linear", "convex"])
def test_energies_are_those_of_the_law(form: dict) -> None:
    law = random_lagrangian(2, 1, 3, **form)
    law.time_unit_s.fill_(0.2)
    single, loaded = Single(law, edits=EDITS), LoadedLagrangian(law, torch.zeros(2).double(), edits=EDITS)
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
    one, two = Single(law, edits=EDITS), Batched(law, edits=EDITS)
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
    assert isinstance(open_stepper(random_lagrangian(2, 1, 0)), Single)
    assert isinstance(open_stepper(random_lagrangian(2, 1, 0, mass="induced")), Batched)
