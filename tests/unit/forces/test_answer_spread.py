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


def push(point: OperatingPoint, force: tuple[float, float]) -> PointLoad:
    grip = point.grasp((16.0, 20.0), radius=1.0)
    return PointLoad(grip.points, torch.tensor([force]).double())


def test_laws_whose_energies_have_another_scale_answer_alike() -> None:
    point = hold_polynomial_strip()
    parameters = ParameterVector(point.law)
    before = parameters.read()
    along = parameters.scale_direction().numpy()
    draws = before.numpy() + np.linspace(-0.3, 0.3, 20)[:, None] * along
    load = push(point, (0.05, 0.05))
    spread = measure_answer_spread(point, draws, load, load.points, reference=push(point, (0.05, 0.0)))
    assert spread is not None
    way = load.points.carry_each(point.equilibria(load)) - load.points.carry(point.rest[None])[0]
    assert np.sqrt(spread).max() < 1e-4 * float(way.norm())
    torch.testing.assert_close(parameters.read(), before)


def test_a_spring_that_is_not_known_spreads_its_own_answers() -> None:
    point = hold_polynomial_strip()
    draws = draw_springs(point, deviation=0.1)
    sideways, down = push(point, (0.05, 0.0)), push(point, (0.0, 0.05))
    of_down = measure_answer_spread(point, draws, down, down.points, reference=sideways)
    of_sideways = measure_answer_spread(point, draws, sideways, sideways.points, reference=sideways)
    assert of_down is not None
    assert of_sideways is not None
    way = down.points.carry_each(point.equilibria(down)) - down.points.carry(point.rest[None])[0]
    assert np.sqrt(of_down[0, 1, 1]) == pytest.approx(0.1 * abs(float(way[0, 1])), rel=0.3)
    assert of_sideways[0, 0, 0] < 0.05 * of_down[0, 1, 1]


def test_a_motion_that_is_not_known_spreads_its_own_answers() -> None:
    point = deviate_stretch(hold_polynomial_strip(), share=0.1)
    same = np.tile(ParameterVector(point.law).read().numpy(), (20, 1))
    sideways, down = push(point, (0.05, 0.0)), push(point, (0.0, 0.05))
    of_down = measure_answer_spread(point, same, down, down.points, reference=sideways)
    of_sideways = measure_answer_spread(point, same, sideways, sideways.points, reference=sideways)
    assert of_down is not None
    assert of_sideways is not None
    way = down.points.carry_each(point.equilibria(down)) - down.points.carry(point.rest[None])[0]
    assert np.sqrt(of_down[0, 1, 1]) == pytest.approx(0.2 * abs(float(way[0, 1])), rel=0.3)  # J C J^T: twice
    assert of_sideways[0, 0, 0] < 0.05 * of_down[0, 1, 1]


def test_the_stiffness_spreads_as_its_spring_does() -> None:
    point = hold_polynomial_strip()
    changes = measure_stiffness_spread(point, draw_springs(point, deviation=0.1))
    assert changes is not None
    stiffness = compute_static_stiffness(point.law, point.rest[None], point.u[None])[0].numpy()
    spread = np.sqrt(np.square(changes).mean(0))
    assert spread[1, 1] == pytest.approx(0.1 * stiffness[1, 1], rel=0.3)
    assert spread[0, 0] < 0.05 * spread[1, 1]


def test_too_few_laws_tell_no_spread() -> None:
    point = hold_polynomial_strip()
    load, theta = push(point, (0.05, 0.0)), ParameterVector(point.law).read().numpy()
    assert measure_answer_spread(point, theta[None], load, load.points, reference=load) is None
    assert measure_stiffness_spread(point, theta[None]) is None
