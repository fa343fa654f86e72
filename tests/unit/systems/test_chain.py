import numpy as np
import pytest
from scipy.integrate import quad

from lagsplat.systems.chain import arc_points


def moment(theta: float, s: float, power: int) -> complex:
    parts = [quad(lambda x, f=f: x**power * f(theta * x), 0, s, epsabs=1e-14)[0] for f in (np.cos, np.sin)]
    return complex(*parts)


@pytest.mark.parametrize("theta", [-2.5, -0.69, 0.0, 1e-9, 0.3, 0.7001, 1.9])
@pytest.mark.parametrize("s", [0.2, 1.0])
def test_arc_is_the_integral_of_its_direction(theta, s):
    value, first, second = arc_points(theta, s)
    np.testing.assert_allclose(value, moment(theta, s, 0), atol=1e-14)
    np.testing.assert_allclose(first, 1j * moment(theta, s, 1), atol=1e-14)
    np.testing.assert_allclose(second, -moment(theta, s, 2), atol=1e-13)


def test_arc_is_smooth_where_the_series_takes_over():
    below, above = arc_points(0.7 - 1e-12, 1.0), arc_points(0.7 + 1e-12, 1.0)
    np.testing.assert_allclose(below, above, atol=5e-12)
