"""What diagnosed effects add to a sim, at one state."""

import numpy as np
import pytest

from lagsplat.diagnose.augmented.simulate import compute_missing_acceleration
from tests.oracle.test_augmented import sim

Q, V, U = np.array([0.4]), np.array([2.0]), np.array([0.5])


def test_more_damping_is_missing_against_the_velocity():
    damped = sim(("viscous_damping", [0.7]))
    missing = compute_missing_acceleration(damped, Q, V, U)
    assert missing[0] == pytest.approx(-damped.parameters(0)["rate"] * V[0], rel=0.05)


def test_nothing_is_missing_without_an_effect():
    assert compute_missing_acceleration(sim(), Q, V, U) == pytest.approx(np.zeros(1), abs=1e-9)


def test_another_number_of_coordinates_is_refused():
    with pytest.raises(ValueError, match="where 1"):
        compute_missing_acceleration(sim(), np.zeros(2), np.zeros(2), U)
