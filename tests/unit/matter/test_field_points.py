"""Points of a field: means, batches, and places in other states."""

import torch

from lagsplat.matter.body_motion import make_body_at_rest
from lagsplat.matter.field import MatterField, join_points
from lagsplat.monomials import make_wide_ball

GENERATOR = torch.Generator().manual_seed(5)


def draw(*shape: int) -> torch.Tensor:
    return torch.randn(*shape, generator=GENERATOR, dtype=torch.float64)


def make_field() -> MatterField:
    """A rigid body and one that bends, of three points each, that move with two coordinates."""
    points, bodies = 5.0 * draw(6, 2), []
    for first, bending in ((0, 0), (3, 1)):
        still = make_body_at_rest(points[first : first + 3], make_wide_ball(2), bending=bending)
        still.coefficients.copy_(0.2 * draw(*still.coefficients.shape))
        bodies.append(still)
    return MatterField(tuple(bodies), points, torch.tensor([0, 0, 0, 1, 1, 1]))


def test_points_move_as_their_bodies_do() -> None:
    field, q = make_field(), draw(4, 2)
    places = field.carry(q)
    for number, body in enumerate(field.bodies):
        own = field.body == number
        torch.testing.assert_close(places[:, own], body.carry(field.points[own], q))
        torch.testing.assert_close(field.jacobian(q[0])[own], body.jacobian(field.points[own], q[:1])[0])


def test_a_mean_of_points_moves_as_the_mean_of_their_places() -> None:
    field, q = make_field(), draw(4, 2)
    weights = torch.tensor([[0.5, 0.25, 0.25, 0, 0, 0], [0, 0, 0, 1.5, -0.5, 0]]).double()
    mean = field.average(weights)
    torch.testing.assert_close(mean.carry(q), weights @ field.carry(q))
    slopes = field.jacobian(q[0])
    torch.testing.assert_close(mean.jacobian(q[0]), torch.einsum("np,pid->nid", weights, slopes))


def test_rows_at_states_of_their_own_are_the_diagonal_of_all() -> None:
    field, q = make_field(), draw(6, 2)
    every = field.every
    assert len(every) == 6
    picked = torch.arange(6)
    torch.testing.assert_close(every.carry_each(q), every.carry(q)[picked, picked])
    slopes = torch.stack([every.jacobian(each) for each in q])
    torch.testing.assert_close(every.differentiate_each(q), slopes[picked, picked])
    again = join_points([every[:2], every[2:]])
    torch.testing.assert_close(again.carry(q), every.carry(q))


def test_points_that_pass_a_place_are_there_in_that_state() -> None:
    field, q, places = make_field(), draw(2), draw(6, 2)
    moved = field.every.passing(places, q)
    torch.testing.assert_close(moved.carry(q[None])[0], places)
    torch.testing.assert_close(moved.jacobian(q), field.jacobian(q))
