"""Motions of bodies: their derivatives are those of the places, and rigid bodies keep distances."""

from dataclasses import replace

import pytest
import torch

from lagsplat.matter.body_motion import BodyMotion, make_body_at_rest
from lagsplat.monomials import enclose_states

GENERATOR = torch.Generator().manual_seed(3)


def draw(*shape: int) -> torch.Tensor:
    return torch.randn(*shape, generator=GENERATOR, dtype=torch.float64)


def make_motion(space: int, bending: int, d: int) -> tuple[BodyMotion, torch.Tensor]:
    points = 10.0 * draw(7, space)
    still = make_body_at_rest(points, enclose_states(draw(300, d)), bending=bending).with_latent_degree(2)
    still.coefficients.copy_(0.3 * draw(*still.coefficients.shape))
    return still, points


@pytest.mark.parametrize(("space", "bending", "d"), [(2, 0, 1), (2, 0, 3), (3, 0, 2), (2, 2, 2), (3, 1, 1)])
def test_jacobians_are_the_derivatives_of_the_places(space: int, bending: int, d: int) -> None:
    motion, points = make_motion(space, bending, d)
    q = draw(d)
    slope = torch.autograd.functional.jacobian(lambda x: motion.carry(points, x[None])[0], q)
    assert torch.allclose(motion.jacobian(points, q[None])[0], slope, atol=1e-9)


@pytest.mark.parametrize("space", [2, 3])
def test_a_rigid_body_keeps_all_distances_far_outside_the_data_too(space: int) -> None:
    motion, points = make_motion(space, 0, 2)
    places = motion.carry(points, 8.0 * draw(4, 2))
    for each in places:
        assert torch.allclose(torch.cdist(each, each), torch.cdist(points, points), atol=1e-9)


@pytest.mark.parametrize("bending", [0, 1, 3])
def test_points_stay_at_the_reference_state_and_before_anything_is_learned(bending: int) -> None:
    motion, points = make_motion(2, bending, 2)
    assert torch.allclose(motion.carry(points, torch.zeros(1, 2).double())[0], points, atol=1e-12)
    still = make_body_at_rest(points, motion.ball, bending=bending)
    assert torch.allclose(still.carry(points, draw(3, 2)), points.expand(3, -1, -1), atol=1e-12)


def test_other_degrees_keep_the_lower_terms() -> None:
    motion, points = make_motion(2, 1, 2)
    richer = motion.with_latent_degree(3)
    q = 0.1 * draw(5, 2)
    assert torch.allclose(richer.carry(points, q), motion.carry(points, q), atol=1e-12)
    assert torch.equal(richer.with_latent_degree(2).coefficients, motion.coefficients)


def test_one_point_is_a_body() -> None:
    point = torch.tensor([[3.0, 4.0]]).double()
    motion = make_body_at_rest(point, enclose_states(draw(20, 1)), bending=0)
    assert motion.size == 1.0
    assert torch.isfinite(motion.jacobian(point, torch.zeros(1, 1).double())).all()


@pytest.mark.parametrize("space", [2, 3])
def test_a_body_that_is_turned_inside_out_folds(space: int) -> None:
    points = 10.0 * draw(7, space)
    still = make_body_at_rest(points, enclose_states(draw(300, 1)), bending=1)
    coefficients = still.coefficients.clone()
    coefficients[0, 1] = -1.0  # of r_0 in the first direction: x becomes x - q (x - center)
    squeezed = replace(still, coefficients=coefficients)
    assert not squeezed.folds(points, torch.tensor([[-2.0], [0.9]]).double())
    assert squeezed.folds(points, torch.tensor([[0.0], [1.1]]).double())
    assert not make_motion(space, 0, 1)[0].folds(points, draw(20, 1))


def test_a_body_folds_where_its_deformation_changes_sign() -> None:
    motion, points = make_motion(2, 2, 1)
    states = torch.linspace(-2.0, 2.0, 41).double()[:, None]
    for q in states:
        slope = torch.autograd.functional.jacobian(lambda x, q=q: motion.carry(x, q[None])[0].sum(0), points)
        signs = torch.linalg.det(slope.movedim(1, 0)) <= 0.0
        for point, sign in zip(points, signs, strict=True):
            assert motion.folds(point[None], q[None]) == bool(sign)
