"""A spot that the sim draws wrongly, and a force on a point of a body whose kinematics are known."""

import numpy as np
import pytest

from lagsplat.diagnose.imaging.localization import compute_excess_error, describe_image_region, localize_force

RNG = np.random.default_rng(0)


def arm(t: int = 300):
    """Points along two hanging rods (five each), with angles relative, in pixels of 30 to a rod."""
    time_s = np.arange(t) / 60.0
    q = np.stack([0.6 * np.sin(5 * time_s), 0.8 * np.sin(7.3 * time_s + 1)], axis=1)
    v = np.stack([3.0 * np.cos(5 * time_s), 0.8 * 7.3 * np.cos(7.3 * time_s + 1)], axis=1)
    share = np.linspace(0.2, 1.0, 5)
    zero = np.zeros(t)

    def along(angle, length):
        return length * np.stack([np.sin(angle), np.cos(angle)], axis=1)

    def turned(angle, length):
        return length * np.stack([np.cos(angle), -np.sin(angle)], axis=1)

    points, jacobians = [], []
    for s in share:
        points.append(along(q[:, 0], 30 * s))
        jacobians.append(np.stack([turned(q[:, 0], 30 * s), np.stack([zero, zero], axis=1)], axis=1))
    for s in share:
        lower = turned(q.sum(axis=1), 30 * s)
        points.append(along(q[:, 0], 30) + along(q.sum(axis=1), 30 * s))
        jacobians.append(np.stack([turned(q[:, 0], 30) + lower, lower], axis=1))
    return np.stack(points, axis=1), np.stack(jacobians, axis=1), v


@pytest.mark.parametrize("point", [3, 7, 9])
def test_a_constant_force_is_found_where_it_pulls(point):
    _, jacobian, v = arm()
    force = jacobian[:, point] @ np.array([0.3, -0.2]) + 0.3 * RNG.standard_normal((300, 2))
    found = localize_force(force, np.broadcast_to(0.09 * np.eye(2), (300, 2, 2)), jacobian, v)
    assert found.localisable
    if point >= 5:
        assert found.point == point
    assert point in found.near  # along the first rod, the lever and the force cannot be told apart


def test_drag_is_found_where_it_brakes():
    points, jacobian, v = arm()
    speed = np.einsum("tac,ta->tc", jacobian[:, 9], v)
    force = np.einsum("tac,tc->ta", jacobian[:, 9], -0.01 * speed)
    found = localize_force(force, np.broadcast_to(np.eye(2), (300, 2, 2)), jacobian, v)
    assert (found.point, found.law[9]) == (9, "drag")
    np.testing.assert_allclose(found.force, -0.01 * speed, atol=1e-6)
    told = describe_image_region(None, found, points)
    assert told["localisable"]
    np.testing.assert_allclose(told["point"], points[:, 9].mean(axis=0))


def test_one_coordinate_tells_no_point_from_another():
    points, jacobian, v = arm()
    one = jacobian[:, :5, :1]
    force = one[:, 2] @ np.array([0.3, -0.2]) + 0.1 * RNG.standard_normal((300, 1))
    found = localize_force(force, np.broadcast_to(np.eye(1), (300, 1, 1)), one, v[:, :1])
    assert not found.localisable
    assert found.point is None
    assert describe_image_region(None, found, points) == {"localisable": False}


def test_noise_is_not_localised():
    _, jacobian, v = arm()
    told = 0
    for _ in range(20):
        force = RNG.standard_normal((300, 2))
        told += localize_force(force, np.broadcast_to(np.eye(2), (300, 2, 2)), jacobian, v).localisable
    assert told <= 1
    with pytest.raises(ValueError, match="zero throughout"):
        localize_force(np.zeros((300, 2)), np.broadcast_to(np.eye(2), (300, 2, 2)), jacobian, v)


def test_excess_is_where_the_sim_draws_wrongly():
    real = RNG.uniform(0, 1, (6, 32, 40, 3))
    encoded = real + 0.05 * RNG.standard_normal(real.shape)
    sim = real + 0.05 * RNG.standard_normal(real.shape)
    assert compute_excess_error(real, sim, encoded).parts == ()
    sim[:, 10:20, 5:12] += 0.5
    left, top, right, bottom, share = compute_excess_error(real, sim, encoded).parts[0]
    assert (left, top, right, bottom) == (5, 10, 12, 20)
    assert share > 0.9
    with pytest.raises(ValueError, match="render all three alike"):
        compute_excess_error(real, sim[:3], encoded)
