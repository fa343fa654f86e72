"""Laws that tell a motion alike: the one without coupled inertia is taken."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.diagnose.identification.structure_search import InformationCriterion, decouple_inertia
from lagsplat.diagnose.mechanics.basis import make_polynomial_basis
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.mechanics.structure import COEFFICIENT_FIELDS

STIFF = np.array([[140.0, -60.0], [-60.0, 100.0]])


def linear(mass: np.ndarray) -> MechanicalModel:
    """``M a = -M A q`` with one ``A`` for every mass, so that all of them move alike."""
    stiff = mass @ STIFF
    basis = make_polynomial_basis(2, centre=np.zeros(2), scale=np.ones(2))
    potential = np.zeros(basis.size)
    for k, (i, j) in enumerate(basis.order):
        if i + j == 2:
            potential[k] = stiff[0, 1] if i == j else 0.5 * stiff[0 if i else 1, 0 if i else 1]
    return MechanicalModel(
        basis=basis,
        mass=mass[None],
        damping=np.zeros((1, 2, 2)),
        potential=potential,
        input_map=np.zeros((0, 0, 2)),
        dry=np.zeros(2),
        drag=np.zeros(2),
        width=np.ones(2),
        rest=np.zeros(2),
    )


def coefficients(model: MechanicalModel) -> np.ndarray:
    return np.concatenate([getattr(model, name).ravel() for name in COEFFICIENT_FIELDS])


@pytest.fixture
def gauge() -> tuple[MechanicalModel, np.ndarray]:
    """A coupled law, and the change of it that no motion tells: masses for which ``M A`` is symmetric."""
    plain, coupled = linear(np.eye(2)), linear(np.eye(2) + 0.004 * STIFF)
    assert np.allclose(coupled.stiffness, coupled.stiffness.T)
    return coupled, coefficients(coupled) - coefficients(plain)


def test_of_laws_that_move_alike_the_uncoupled_one_is_taken(
    gauge: tuple[MechanicalModel, np.ndarray],
) -> None:
    coupled, change = gauge
    q, v, u = np.array([[0.3, -0.2]]), np.array([[1.0, 0.5]]), np.zeros((1, 0))
    assert abs(coupled.mass[0][0, 1]) > 0.2
    apart, freedom = decouple_inertia(coupled, 20.0 * change[None])
    assert abs(apart.mass[0][0, 1]) < 0.01
    np.testing.assert_allclose(apart.acceleration(q, v, u), coupled.acceleration(q, v, u), rtol=1e-9)
    assert np.linalg.norm(freedom) < 0.1 * np.linalg.norm(20.0 * change)


def test_what_the_motion_tells_of_the_coupling_stays(gauge: tuple[MechanicalModel, np.ndarray]) -> None:
    coupled, change = gauge
    told, freedom = decouple_inertia(coupled, 0.01 * change[None])
    np.testing.assert_allclose(told.mass, coupled.mass, rtol=1e-3)
    np.testing.assert_allclose(np.abs(freedom[0]), np.abs(0.01 * change), rtol=1e-2)
    assert decouple_inertia(coupled, np.zeros((0, len(change))))[0] is coupled


def test_an_inertia_that_would_not_be_positive_is_not_taken(
    gauge: tuple[MechanicalModel, np.ndarray],
) -> None:
    coupled, change = gauge
    heavy = change.copy()
    heavy[0] += 40.0
    assert decouple_inertia(coupled, 20.0 * heavy[None])[0] is coupled


def test_correlated_samples_do_not_ask_for_more_terms() -> None:
    small, large = (
        InformationCriterion(misfit, n_data=2000.0, n_free=n, correlation=1.0)
        for misfit, n in ((4000.0, 5), (3900.0, 9))
    )
    assert large.exceed(small) < 0.0  # 2.5 % of white noise are worth four terms
    tied = [replace(each, correlation=8.0) for each in (small, large)]
    assert tied[1].exceed(tied[0]) > 0.0
    # an error of the law is correlated as well: the better fit shows what is noise
    assert large.exceed(tied[0]) == large.exceed(small)
