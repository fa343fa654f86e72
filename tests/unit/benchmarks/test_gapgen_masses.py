"""Payloads, shaken bases and forces across coordinates, against what mechanics says of them."""

import numpy as np
import pytest

from benchmarks.gapgen import laws
from benchmarks.gapgen.bases import base_pull
from benchmarks.gapgen.effect import Effect
from benchmarks.gapgen.mechanisms import Mechanism, damping_slots, draw_mechanism, terms
from benchmarks.gapgen.motion import Plan, World
from benchmarks.gapgen.payloads import with_payload


def fields(m: Mechanism, q: np.ndarray, v: np.ndarray) -> tuple[np.ndarray, ...]:
    work = (np.zeros((m.d, m.d)), np.zeros(m.d), np.zeros(m.d), np.zeros(m.d))
    terms(m.kind, m.p, q, v, *work)
    return work


def place_of(m: Mechanism, q: np.ndarray) -> np.ndarray:
    """Where the payload of the first coordinate is, (x, z)."""
    length = {"two_link": m.p[3], "pendulum": m.p[2], "acrobot": m.p[2], "bag": None}[m.system]
    if length is None:
        length = m.p[3] + q[1]
    return length * np.array([np.sin(q[0]), -np.cos(q[0])])


@pytest.mark.parametrize("system", ["pendulum", "two_link", "acrobot", "bag"])
def test_a_payload_has_the_inertia_and_the_weight_of_a_point_mass(system: str) -> None:
    m, kg = draw_mechanism(system, np.random.default_rng(1)), 0.3
    q = 0.6 * m.size
    jacobian = np.stack(
        [(place_of(m, q + h) - place_of(m, q - h)) / 2e-5 for h in 1e-5 * np.eye(m.d)], axis=1
    )
    (mass, *_, grad), (loaded, *_, more) = (
        fields(each, q, np.zeros(m.d)) for each in (m, with_payload(m, 0, kg))
    )
    np.testing.assert_allclose(loaded - mass, kg * jacobian.T @ jacobian, atol=1e-9)
    # the bag's spring is slack where the bag hangs, with or without a load
    weight = kg * 9.81 * jacobian[1] - (kg * 9.81 * np.array([0.0, -1.0]) if system == "bag" else 0.0)
    np.testing.assert_allclose(more - grad, weight, atol=1e-8)


def test_where_there_is_no_place_for_a_payload_it_is_said() -> None:
    with pytest.raises(ValueError, match="no payload"):
        with_payload(draw_mechanism("rocker", np.random.default_rng(1)), 0, 0.1)


@pytest.mark.parametrize("system", ["two_link", "acrobot", "bag", "soft_robot"])
def test_a_base_pulls_by_what_each_mass_moves_sideways(system: str) -> None:
    m = draw_mechanism(system, np.random.default_rng(2))
    q = 0.7 * m.size

    def moment(q: np.ndarray) -> float:
        """Sum of mass times x."""
        angle = np.cumsum(q)
        if system == "bag":
            return m.p[0] * (m.p[3] + q[1]) * np.sin(q[0])
        if system == "acrobot":
            m1, m2, l1, c1, c2 = m.p[:5]
            return (m1 * c1 + m2 * l1) * np.sin(angle[0]) + m2 * c2 * np.sin(angle[1])
        masses, lengths = m.p[1 : 1 + m.d], m.p[1 + m.d : 1 + 2 * m.d]
        return float(masses @ np.cumsum(lengths * np.sin(angle)))

    pull = np.zeros(m.d)
    base_pull(m.kind, m.p, q, fields(m, q, 0.0 * q)[0], pull)
    expected = [(moment(q + h) - moment(q - h)) / 2e-6 for h in 1e-6 * np.eye(m.d)]
    np.testing.assert_allclose(pull, expected, rtol=1e-6)


def test_a_base_along_the_first_coordinate_acts_by_its_column_of_inertia() -> None:
    m = draw_mechanism("cart_pole", np.random.default_rng(2))
    q, pull = 0.5 * m.size, np.zeros(2)
    mass = fields(m, q, 0.0 * q)[0]
    base_pull(m.kind, m.p, q, mass, pull)
    np.testing.assert_array_equal(pull, mass[:, 0])


def test_a_force_across_coordinates_is_skew_and_by_speed_does_no_work() -> None:
    m = draw_mechanism("two_link", np.random.default_rng(4))
    p = m.p.copy()
    p[damping_slots(m.kind, m.d)] = 0.0
    m = Mechanism(m.system, m.kind, 2, p, m.b, m.size)
    inertia = np.diag(m.inertia_at_rest())
    lean = np.sqrt(inertia[1] / inertia[0])
    rows = [
        (laws.COUPLING, 0, 0, [3.0 * lean, 1, 1.0, 1.0]),
        (laws.COUPLING, 1, 0, [-3.0 / lean, 0, 1.0, 1.0]),
    ]
    assert rows[0][3][0] * inertia[0] == pytest.approx(-rows[1][3][0] * inertia[1])
    plan = Plan(0.005, [0.0], [np.array([*(0.6 * m.size), 0.0, 0.0])], [0], [np.zeros((500, 2))])

    def energy(effects: list[Effect]) -> np.ndarray:
        x = World(m, effects).move(plan)[0].x
        kinetic = np.array([0.5 * s[2:] @ fields(m, s[:2], s[2:])[0] @ s[2:] for s in x])
        slope = np.array([fields(m, s[:2], s[2:])[3] for s in x])
        height = (np.diff(x[:, :2], axis=0) * 0.5 * (slope[1:] + slope[:-1])).sum(axis=1)
        return kinetic + np.concatenate([[0.0], np.cumsum(height)])

    free, turned = energy([]), energy([Effect("circulatory_force", rows)])
    assert np.ptp(turned) < 5e-3 * np.ptp(turned + 0.0 * free) + 5e-3 * abs(free).max() + 1e-4
