"""Spread of answers over drawn laws: of a scale of all energies none, of an uncertain spring its own."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from lagsplat.forces.answer_spread import measure_answer_spread
from lagsplat.forces.equilibrium import settle
from lagsplat.forces.loads import PointLoad
from lagsplat.forces.operating_point import OperatingPoint
from lagsplat.stage2.likelihood.parameter_vector import POTENTIAL, ParameterVector
from tests.stage2_problems import random_lagrangian
from tests.unit.forces.rocking import hanging


def hold() -> OperatingPoint:
    """The hanging strip under a law of polynomials."""
    law = random_lagrangian(2, 1, 3, amount=0.02, terms="polynomial", map_degree=1)
    held = hanging()
    return replace(held, law=law, rest=settle(law, held.u[None])[0])


def push(held: OperatingPoint, force: tuple[float, float]) -> PointLoad:
    grip = held.grasp((16.0, 20.0), radius=1.0)
    return PointLoad(grip.points, torch.tensor([force]).double())


def test_laws_whose_energies_have_another_scale_answer_alike() -> None:
    held = hold()
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
    held = hold()
    parameters = ParameterVector(held.law)
    theta = parameters.read().numpy()
    square = held.law.energy.exponents.tolist().index([0.0, 2.0])  # of the coordinate that stretches
    column = int(parameters.find_columns(POTENTIAL)[square])
    draws = np.tile(theta, (40, 1))
    draws[:, column] *= 1.0 + 0.1 * np.tile([-1.0, 1.0], 20)
    sideways, down = push(held, (0.05, 0.0)), push(held, (0.0, 0.05))
    of_down = measure_answer_spread(held, draws, down, down.points, reference=sideways)
    of_sideways = measure_answer_spread(held, draws, sideways, sideways.points, reference=sideways)
    assert of_down is not None
    assert of_sideways is not None
    way = down.points.carry_each(held.equilibria(down)) - down.points.carry(held.rest[None])[0]
    assert np.sqrt(of_down[0, 1, 1]) == pytest.approx(0.1 * abs(float(way[0, 1])), rel=0.3)
    assert of_sideways[0, 0, 0] < 0.05 * of_down[0, 1, 1]


def test_too_few_laws_tell_no_spread() -> None:
    held = hold()
    load, theta = push(held, (0.05, 0.0)), ParameterVector(held.law).read().numpy()
    assert measure_answer_spread(held, theta[None], load, load.points, reference=load) is None
