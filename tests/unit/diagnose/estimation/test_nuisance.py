"""The sim's small uncertainties: what each of them does, and that none of them does anything at zero."""

import numpy as np
import pytest

from lagsplat.diagnose.estimation.nuisance import NuisanceParameters
from lagsplat.diagnose.mechanics.structure import COEFFICIENT_FIELDS, flatten_coefficients
from tests.unit.diagnose.toys import coupled


def nuisance(n_directions: int = 2) -> NuisanceParameters:
    size = len(flatten_coefficients(coupled()))
    directions = np.random.default_rng(0).normal(size=(n_directions, size))
    return NuisanceParameters(0.01, 0.02, 0.03, 0.04, np.array([0.1, 0.2]), 0.05, 2, directions)


NAMES = (
    *("potential", "damping", "input 0", "input 1", "inertia 0", "inertia 1"),
    *("offset 0", "offset 1", "warp 0", "warp 1"),
    *("identification 0", "identification 1"),
)


def test_deviations_stand_in_the_order_of_the_fields() -> None:
    known = nuisance()
    assert len(known.deviation) == known.size
    named = dict(zip(NAMES, known.deviation, strict=True))
    assert named["potential"] == 0.01
    assert named["damping"] == 0.02
    assert named["input 1"] == 0.03
    assert named["inertia 0"] == 0.04
    assert named["offset 1"] == 0.2
    assert named["warp 0"] == 0.05
    assert named["identification 1"] == 1.0


def test_nothing_moved_is_the_sim_itself() -> None:
    known, model = nuisance(), coupled()
    fields = known.change_coefficients(model, np.zeros((3, known.size)))
    for name in COEFFICIENT_FIELDS:
        assert np.array_equal(getattr(fields, name), np.stack([getattr(model, name)] * 3))
    y = np.random.default_rng(0).normal(size=(3, 2, 4, 2))
    assert np.array_equal(known.observe(y, np.zeros((3, known.size)), model), y)


def at(name: str, value: float) -> np.ndarray:
    known = nuisance()
    x = np.zeros((1, known.size))
    x[0, NAMES.index(name)] = value
    return x


def test_each_uncertainty_does_what_its_name_says() -> None:
    known, model = nuisance(), coupled()
    assert known.change_coefficients(model, at("potential", 0.1)).potential[0] == pytest.approx(
        1.1 * model.potential
    )
    damping = known.change_coefficients(model, at("damping", 0.1)).damping[0]
    assert damping[0] == pytest.approx(model.damping[0] + 0.1 * model.inertia)
    assert np.array_equal(damping[1:], model.damping[1:])
    gained = known.change_coefficients(model, at("input 1", 0.1)).input_map[0]
    assert gained[:, 1] == pytest.approx(1.1 * model.input_map[:, 1])
    assert np.array_equal(gained[:, 0], model.input_map[:, 0])


def test_the_inertia_along_one_coordinate_leaves_the_other_and_stays_positive() -> None:
    known, model = nuisance(), coupled()
    heavier = known.change_coefficients(model, at("inertia 0", 0.21)).mass[0]
    assert heavier[:, 0, 0] == pytest.approx(1.21 * model.mass[:, 0, 0])
    assert heavier[:, 0, 1] == pytest.approx(1.1 * model.mass[:, 0, 1])
    assert np.array_equal(heavier[:, 1, 1], model.mass[:, 1, 1])
    none_left = known.change_coefficients(model, at("inertia 0", -5.0)).mass[0]
    assert np.linalg.eigvalsh(none_left[0])[0] > 0.0


def test_one_coordinate_has_no_inertia_of_its_own_to_be_uncertain_about() -> None:
    alone = NuisanceParameters(0.01, 0.02, 0.03, 0.04, np.array([0.1]), 0.05, 1, np.zeros((0, 0)))
    assert alone.size == 5
    assert 0.04 not in alone.deviation.tolist()


def test_an_offset_is_a_constant_force_of_so_much_acceleration() -> None:
    known, model = nuisance(), coupled()
    tilted = known.change_coefficients(model, at("offset 1", 0.7)).potential[0] - model.potential
    q = np.random.default_rng(0).normal(size=(5, 2))
    force = -np.einsum("nki,k->ni", model.basis.slopes(q), tilted)
    assert force == pytest.approx(np.tile([0.0, 0.7 * model.inertia[1, 1]], (5, 1)), abs=1e-12)


def test_a_warp_bends_one_coordinate_about_rest() -> None:
    known, model = nuisance(), coupled()
    y = np.random.default_rng(0).normal(size=(1, 2, 4, 2))
    seen = known.observe(y, at("warp 0", 0.1), model)
    assert seen[..., 0] == pytest.approx(y[..., 0] + 0.1 * y[..., 0] ** 2 / 0.8)
    assert np.array_equal(seen[..., 1], y[..., 1])


def test_directions_move_all_coefficients_in_their_order() -> None:
    known, model = nuisance(), coupled()
    moved = known.change_coefficients(model, at("identification 1", 0.5))
    told = np.concatenate([getattr(moved, name)[0].ravel() for name in COEFFICIENT_FIELDS])
    assert told == pytest.approx(flatten_coefficients(model) + 0.5 * known.directions[1])
    assert np.array_equal(known.change_coefficients(model, at("warp 0", 0.5)).mass[0], model.mass)


def test_pinned_leaves_next_to_nothing_uncertain() -> None:
    known = nuisance()
    model = coupled()
    x = np.ones((1, known.size)) * known.freeze().deviation
    fields = known.freeze().change_coefficients(model, x)
    assert np.concatenate([getattr(fields, n)[0].ravel() for n in COEFFICIENT_FIELDS]) == pytest.approx(
        flatten_coefficients(model), abs=1e-4
    )
