"""Laws that tell a motion alike: the one without coupled inertia is taken."""

import numpy as np
import pytest

from lagsplat.diagnose.identification.structure_search import uncoupled
from lagsplat.diagnose.mechanics.basis import polynomial
from lagsplat.diagnose.mechanics.model import Model
from lagsplat.diagnose.mechanics.structure import COEFFICIENTS

STIFF = np.array([[140.0, -60.0], [-60.0, 100.0]])


def linear(mass: np.ndarray) -> Model:
    """``M a = -M A q`` with one ``A`` for every mass, so that all of them move alike."""
    stiff = mass @ STIFF
    basis = polynomial(2, centre=np.zeros(2), scale=np.ones(2))
    potential = np.zeros(basis.size)
    for k, (i, j) in enumerate(basis.order):
        if i + j == 2:
            potential[k] = stiff[0, 1] if i == j else 0.5 * stiff[0 if i else 1, 0 if i else 1]
    return Model(
        basis=basis, mass=mass[None], damping=np.zeros((1, 2, 2)), potential=potential,
        input_map=np.zeros((0, 0, 2)), dry=np.zeros(2), drag=np.zeros(2), width=np.ones(2), rest=np.zeros(2),
    )  # fmt: skip


def coefficients(model: Model) -> np.ndarray:
    return np.concatenate([getattr(model, name).ravel() for name in COEFFICIENTS])


@pytest.fixture
def gauge() -> tuple[Model, np.ndarray]:
    """A coupled law, and the change of it that no motion tells: masses for which ``M A`` is symmetric."""
    plain, coupled = linear(np.eye(2)), linear(np.eye(2) + 0.004 * STIFF)
    assert np.allclose(coupled.stiffness, coupled.stiffness.T)
    return coupled, coefficients(coupled) - coefficients(plain)


def test_of_laws_that_move_alike_the_uncoupled_one_is_taken(gauge: tuple[Model, np.ndarray]) -> None:
    coupled, change = gauge
    q, v, u = np.array([[0.3, -0.2]]), np.array([[1.0, 0.5]]), np.zeros((1, 0))
    assert abs(coupled.mass[0][0, 1]) > 0.2
    apart, freedom = uncoupled(coupled, 20.0 * change[None])
    assert abs(apart.mass[0][0, 1]) < 0.01
    np.testing.assert_allclose(apart.acceleration(q, v, u), coupled.acceleration(q, v, u), rtol=1e-9)
    assert np.linalg.norm(freedom) < 0.1 * np.linalg.norm(20.0 * change)


def test_what_the_motion_tells_of_the_coupling_stays(gauge: tuple[Model, np.ndarray]) -> None:
    coupled, change = gauge
    told, freedom = uncoupled(coupled, 0.01 * change[None])
    np.testing.assert_allclose(told.mass, coupled.mass, rtol=1e-3)
    np.testing.assert_allclose(np.abs(freedom[0]), np.abs(0.01 * change), rtol=1e-2)
    assert uncoupled(coupled, np.zeros((0, len(change))))[0] is coupled


def test_an_inertia_that_would_not_be_positive_is_not_taken(gauge: tuple[Model, np.ndarray]) -> None:
    coupled, change = gauge
    heavy = change.copy()
    heavy[0] += 40.0
    assert uncoupled(coupled, 20.0 * heavy[None])[0] is coupled
