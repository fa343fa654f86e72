"""The energy balance closes up to the error of the integrator."""

import numpy as np
import pytest

from lagsplat.forces.loaded_lagrangian import make_fast_lagrangian
from lagsplat.stage2.lagrangian import LawEdits
from lagsplat.viewer.simulation.grasp import EnergyBalance
from tests.stage2_problems import random_lagrangian


def left_over(dt_s: float) -> tuple[float, float]:
    """Error of the books of one second with pushes, inputs and an edit, and the largest flow."""
    base = random_lagrangian(2, 1, 3)
    law, q, v = make_fast_lagrangian(base), np.array([0.3, -0.2]), np.zeros(2)
    books = EnergyBalance.begin(law, q, v)
    for i in range(round(1.0 / dt_s)):
        if i == round(0.5 / dt_s):
            law = make_fast_lagrangian(base, edits=LawEdits(stiffness=1.5, inertia=0.8, damping=2.0))
            books = books.after_edit(law, q, v)
        u, load = np.array([0.6 * (i * dt_s > 0.2)]), np.array([0.4, -0.1]) * (i * dt_s < 0.7)
        after = law.step(q, v, u, load, dt_s=dt_s)
        books = books.after_step(law, (q, v), after, u, load, dt_s=dt_s)
        q, v = after
    flows = [abs(books.hand_work), abs(books.input_work), abs(books.edit_work), books.dissipated]
    assert min(flows) > 0.0
    assert books.total == pytest.approx(law.kinetic(q, v) + law.potential(q))
    return books.error, max(flows)


def test_the_energy_balance_closes_up_to_an_error_of_second_order():
    coarse, flow = left_over(0.02)
    fine, _ = left_over(0.01)
    assert abs(coarse) < 0.3 * flow
    assert abs(fine) < 0.35 * abs(coarse)
