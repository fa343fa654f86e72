"""Spread of answers over drawn laws: of a scale of all energies none, of an uncertain spring its own."""

import numpy as np
import pytest
import torch

from lagsplat.forces.answer_spread import measure_answer_spread, measure_stiffness_spread
from lagsplat.forces.loads import PointLoad
from lagsplat.forces.operating_point import OperatingPoint
from lagsplat.stage2.equilibrium import compute_static_stiffness
from lagsplat.stage2.likelihood.parameter_vector import ParameterVector
from tests.unit.forces.rocking import deviate_stretch, draw_springs, hold_polynomial_strip


def push(held: OperatingPoint, force: tuple[float, float]) -> PointLoad:
    grip = held.grasp((16.0, 20.0), radius=1.0)
    return PointLoad(grip.points, torch.tensor([force]).double())


def test_laws_whose_energies_have_another_scale_answer_alike() -> None:
    held = hold_polynomial_strip()
    parameters = ParameterVector(held.law)
    before = parameters.read()
    along = parameters.scale_direction().numpy()
    draws = before.numpy() + np.linspace(-0.3, 0.3, 20)[:, None] * along
    load = push(held, (0.05, 0.05))
    spread = measure_answer_spread(held, draws, load, load.points, reference=push(held, (0.05, 0.0)))
    assert spread is not None
    way = load.points.carry_each(held.equilibria(load)) - load.points.carry(held.rest[None])[0]
    assert np.sqrt(spread).max() < 1e-4 * float(way.norm())
    torch.testing.assert_close(parameters.read(), before)


def test_a_spring_that_is_not_known_spreads_its_own_answers() -> None:
    held = hold_polynomial_strip()
    draws = draw_springs(held, deviation=0.1)
    sideways, down = push(held, (0.05, 0.0)), push(held, (0.0, 0.05))
    of_down = measure_answer_spread(held, draws, down, down.points, reference=sideways)
    of_sideways = measure_answer_spread(held, draws, sideways, sideways.points, reference=sideways)
    assert of_down is not None
    assert of_sideways is not None
    way = down.points.carry_each(held.equilibria(down)) - down.points.carry(held.rest[None])[0]
    assert np.sqrt(of_down[0, 1, 1]) == pytest.approx(0.1 * abs(float(way[0, 1])), rel=0.3)
    assert of_sideways[0, 0, 0] < 0.05 * of_down[0, 1, 1]


def test_a_motion_that_is_not_known_spreads_its_own_answers() -> None:
    held = deviate_stretch(hold_polynomial_strip(), share=0.1)
    same = np.tile(ParameterVector(held.law).read().numpy(), (20, 1))
    sideways, down = push(held, (0.05, 0.0)), push(held, (0.0, 0.05))
    of_down = measure_answer_spread(held, same, down, down.points, reference=sideways)
    of_sideways = measure_answer_spread(held, same, sideways, sideways.points, reference=sideways)
    assert of_down is not None
    assert of_sideways is not None
    way = down.points.carry_each(held.equilibria(down)) - down.points.carry(held.rest[None])[0]
    assert np.sqrt(of_down[0, 1, 1]) == pytest.approx(0.2 * abs(float(way[0, 1])), rel=0.3)  # J C J^T: twice
    assert of_sideways[0, 0, 0] < 0.05 * of_down[0, 1, 1]


def test_the_stiffness_spreads_as_its_spring_does() -> None:
    held = hold_polynomial_strip()
    changes = measure_stiffness_spread(held, draw_springs(held, deviation=0.1))
    assert changes is not None
    stiffness = compute_static_stiffness(held.law, held.rest[None], held.u[None])[0].numpy()
    spread = np.sqrt(np.square(changes).mean(0))
    assert spread[1, 1] == pytest.approx(0.1 * stiffness[1, 1], rel=0.3)
    assert spread[0, 0] < 0.05 * spread[1, 1]


def test_too_few_laws_tell_no_spread() -> None:
    held = hold_polynomial_strip()
    load, theta = push(held, (0.05, 0.0)), ParameterVector(held.law).read().numpy()
    assert measure_answer_spread(held, theta[None], load, load.points, reference=load) is None
    assert measure_stiffness_spread(held, theta[None]) is None
