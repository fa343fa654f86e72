"""A model that is right, and the same model made wrong in ways the errors must tell."""

from dataclasses import replace

import numpy as np
import pytest
import torch

from lagsplat.config.compose import compose
from lagsplat.evaluate.forces.accuracy import are_alike, choose_grasps, compare_answers
from lagsplat.evaluate.forces.invariants import centre_of_rotation, force_invariants
from lagsplat.evaluate.forces.known_forces import KnownForces, simulate_known_forces
from lagsplat.evaluate.forces.motion import (
    easiest_direction,
    measure_energy_spans,
    respond_at_once,
    respond_in_time,
)
from lagsplat.evaluate.truth import fit_polynomial
from lagsplat.forces.loads import PointLoad
from lagsplat.forces.operating_point import NoScaleError, OperatingPoint, fit_energy_scale
from lagsplat.systems.pushable import Pushable
from tests.unit.evaluate.tiny_run import FREQUENCY_HZ, RATE_PER_S
from tests.unit.forces.rocking import CONTACT, hanging, rocking

SETTINGS = replace(compose().forces, points=3, directions=4, levels=[0.1, 0.3, 1.0, 2.0])
JOULE = 7.0  # of the law's energy
OMEGA2 = (2 * np.pi * FREQUENCY_HZ) ** 2 + RATE_PER_S**2


def twin(point: OperatingPoint, *, stiffening: float = 0.0) -> Pushable:
    """The system that `point` models without error, in seconds and joule; stiffer further out if asked."""
    places = np.array([(x, y) for x in (13.0, 16.0, 19.0) for y in (9.0, 12.0, 15.0)])
    if point.law.d == 2:
        places = np.array([(16.0, y) for y in (6.0, 10.0, 14.0, 18.0)])
    field = choose_grasps(point, places, radius=0.96).points.jacobian(point.rest).numpy()
    eye, unit = np.eye(point.law.d), float(point.law.time_unit_s) ** 2 / JOULE

    def force(q: np.ndarray) -> np.ndarray:
        return -unit * OMEGA2 * q * (1.0 + stiffening * q @ q)

    def acceleration(q: np.ndarray, v: np.ndarray, push: np.ndarray) -> np.ndarray:
        return (force(q) + push) / unit - 2 * RATE_PER_S * v

    return Pushable(
        rest=np.zeros(point.law.d),
        force=force,
        acceleration=acceleration,
        mass=lambda q: unit * eye,
        places=lambda states: places + np.einsum("pcd,td->tpc", field, states),
        share=np.ones(len(places)),
    )


def poked(point: OperatingPoint, system: Pushable) -> KnownForces:
    return simulate_known_forces(system, point.chart.latents, SETTINGS)


@pytest.mark.parametrize("build", [rocking, hanging], ids=["rocking", "hanging"])
def test_a_perfect_model_has_no_error_but_that_of_its_scale(build) -> None:
    point = build()
    system = twin(point)
    pokes = poked(point, system)
    found = compare_answers(point, pokes, radius=0.96, read=lambda q: system.places(q))
    inside = found["inside"]
    assert found["scale"] == pytest.approx(JOULE, rel=1e-2)
    assert inside["direction_deg"] < 0.1
    assert inside["shape"] < 1e-3
    assert inside["amplitude_p90"] < 0.02
    assert inside["pictured_shape"] < 1e-3
    assert found["scale_of_others"] == pytest.approx([1.0, 1.0, 1.0], abs=0.02)
    assert [row["level"] for row in found["levels"]] == SETTINGS.levels
    assert found["missed"] == found["tipped"] == 0
    assert {len(row["place"]) for row in found["map"]} == {2}


def test_a_system_that_stiffens_is_answered_ever_more_wrongly() -> None:
    point = rocking()
    pokes = poked(point, twin(point, stiffening=0.5))
    rows = compare_answers(point, pokes, radius=0.96, read=lambda q: twin(point).places(q))["levels"]
    amplitudes = [row["amplitude"] for row in rows]
    assert amplitudes[1] < 0.05 < amplitudes[2] < amplitudes[3]
    assert all(row["shape"] < 1e-3 for row in rows), "the way is right, its length is not"


def test_another_body_is_told_by_shape_and_direction() -> None:
    point = hanging()
    system = twin(point)
    places, turned = system.places(np.zeros((1, 2)))[0], np.exp(1j * np.radians(40.0))
    uneven = np.array([1.0, 0.3, 1.0, 0.3])[:, None]

    def pixels(states: np.ndarray) -> np.ndarray:
        ways = system.places(states) - places
        ways = (ways @ [1.0, 1.0j]) * turned
        return places + uneven * np.stack([ways.real, ways.imag], axis=2)

    found = compare_answers(point, poked(point, replace(system, places=pixels)), radius=0.96, read=pixels)
    assert found["inside"]["shape"] > 0.3
    assert found["inside"]["direction_deg"] > 20


def test_an_answer_the_wrong_way_has_no_scale() -> None:
    point = rocking()
    grip, down = point.grasp((20.0, 12.0), radius=1.0), torch.tensor([[0.0, 1.0]], dtype=torch.float64)
    way = 0.1 * grip.jacobian(point.rest).numpy()[None, :, 0]
    scale = fit_energy_scale(point, PointLoad(grip.points, down), grip.points, way)
    q = point.equilibria(PointLoad(grip.points, scale * down))
    assert float(q[0, 0]) == pytest.approx(0.1, rel=1e-2)
    with pytest.raises(NoScaleError, match="against the measured displacement"):
        fit_energy_scale(point, PointLoad(grip.points, down), grip.points, -way)


def test_the_motion_in_time_is_that_of_the_system() -> None:
    point = rocking()
    system = twin(point)
    pokes = poked(point, system)
    grasps = choose_grasps(point, pokes.places, radius=0.96)
    right, wrong = (
        respond_in_time(point, system, pokes, grasps, scale=scale, length_s=0.5)
        for scale in (JOULE, 2 * JOULE)
    )
    assert right["error"] < 0.02
    assert wrong["error"] == pytest.approx(1.0, rel=0.05)
    assert wrong["shape"] < 0.02


def test_the_first_motion_tells_a_wrong_mass() -> None:
    point = hanging()
    system = twin(point)
    pokes = poked(point, system)
    pokes = replace(pokes, direction=np.full_like(pokes.direction, np.sqrt(0.5)))  # on both coordinates
    grasps = choose_grasps(point, pokes.places, radius=0.96)
    found = respond_at_once(point, system, pokes, grasps)
    assert found["learned"] < 1e-6
    assert min(found["uniform"], found["true"]) > 1e-3, "points of equal mass are not the law's mass here"
    assert pokes.reference == 1
    assert len(easiest_direction(pokes, grasps, 1)) == len(np.unique(pokes.point))


def test_energies_are_spanned_by_what_no_common_factor_explains() -> None:
    point = hanging()
    system, eye = twin(point), np.eye(2)
    right = measure_energy_spans(point, system, eye)
    assert right is not None
    assert right["mass"] == pytest.approx(1.0)
    assert right["stiffness"] == pytest.approx(1.0, rel=1e-4)
    assert right["induced"] > 1.1
    uneven = measure_energy_spans(point, system, np.diag([1.0, 3.0]))
    assert uneven is not None
    assert uneven["mass"] == pytest.approx(9.0)
    assert measure_energy_spans(rocking(), twin(rocking()), np.eye(1)) is None


def test_points_outside_the_picture_are_missed() -> None:
    point = rocking()
    grasps = choose_grasps(point, np.array([[16.0, 12.0], [-3.0, 12.0]]), radius=1.0)
    assert grasps.usable.tolist() == [True, False]
    ways = grasps.follow(np.array([[0.5]])) - grasps.follow(point.rest.numpy())
    assert ways[0, 0].any()
    assert not ways[0, 1].any()


def test_likeness_is_one_for_the_same_way_however_long() -> None:
    way = np.random.default_rng(0).standard_normal((2, 1, 3, 2))
    cosine, factor = are_alike(3.0 * way, way)
    assert cosine == pytest.approx(np.ones((2, 1)))
    assert factor == pytest.approx(3.0 * np.ones((2, 1)))


def test_the_invariants_hold_on_a_rocker() -> None:
    point = rocking()
    found = force_invariants(point, SETTINGS)
    assert found["lever"]["rank"] > 0.95
    assert found["lever"]["sign"] > 0.9
    assert found["lever"]["left"] * found["lever"]["right"] < 0
    assert found["background"]["points"] > 0
    assert found["background"]["largest"] == 0.0
    assert found["superposition"]["force"] < 1e-12
    assert found["superposition"]["small_answer"] < 1e-6
    assert found["chart"]["state"] < 1e-6
    assert found["chart"]["picture"] < 1e-5
    assert found["across"] < 1e-12
    grips = [point.grasp((x, 12.0), radius=1.0) for x in (12.0, 16.0, 20.0)]
    assert centre_of_rotation(grips, point.rest) == pytest.approx(CONTACT, abs=0.1)


def test_the_invariants_of_an_arm_have_no_lever() -> None:
    found = force_invariants(hanging(), SETTINGS)
    assert found["lever"] is None
    assert found["across"] is None
    assert found["background"]["largest"] == 0.0
    assert found["chart"]["state"] < 1e-6


def test_places_are_read_off_latents() -> None:
    point = rocking()
    system = twin(point)
    states = np.concatenate([point.chart.latents, point.chart.latents])

    to_states = fit_polynomial(point.chart.train.smoothed(1.0).latents, states[: point.chart.n_train])
    q = point.chart.train.smoothed(1.0).latents[5:9]
    assert system.places(to_states(q)) == pytest.approx(system.places(point.chart.latents[5:9]), abs=0.1)
