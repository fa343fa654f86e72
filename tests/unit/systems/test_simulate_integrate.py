import numpy as np
import pytest

from lagsplat.systems.arm import build_arm
from lagsplat.systems.simulate import integrate

DT_S = 1001 / 60000


@pytest.mark.parametrize("name", ["krauss_1seg", "krauss_2seg"])
def test_small_free_decay_has_the_linear_frequency_and_rate(load, name):
    arm = build_arm(load(name).arm)
    modes, rest = arm.modes(), arm.equilibrium(np.zeros(arm.d))
    q = rest.copy()
    q[0::2] += 0.01
    free = np.zeros((int(6 / modes.damped_hz[0] / DT_S), arm.d))
    angle = integrate(arm, q, np.zeros(arm.d), free, dt_s=DT_S, rtol=1e-9, atol=1e-12)[0][:, 0]
    # By then the faster modes are gone, and two samples predict the third.
    late = angle[int(1.2 / modes.damped_hz[0] / DT_S) :]
    past = np.stack([late[1:-1], late[:-2]], axis=1)
    one, two = np.linalg.lstsq(past, late[2:], rcond=None)[0]
    root = np.log(np.roots([1, -one, -two]).astype(complex)[0]) / DT_S
    assert abs(root.imag) / (2 * np.pi) == pytest.approx(modes.damped_hz[0], rel=2e-3)
    assert -root.real == pytest.approx(modes.decay_per_s[0], rel=2e-2)


def test_constant_pressure_settles_at_its_equilibrium(load):
    arm = build_arm(load("toy", arm={"retardation_s": 0.15}).arm)
    pressure = np.array([0.6, 0.2])
    q = integrate(
        arm, np.zeros(2), np.zeros(2), np.tile(pressure, (600, 1)), dt_s=DT_S, rtol=1e-9, atol=1e-12
    )[0]
    np.testing.assert_allclose(q[-1], arm.equilibrium(pressure), atol=1e-7)


def test_leaving_the_physical_range_is_said(load):
    arm = build_arm(load("toy", arm={"bending_stiffness": [1e-9], "extension_stiffness": [1e-9]}).arm)
    with pytest.raises(RuntimeError, match="physical range"):
        integrate(arm, np.zeros(2), np.array([1e160, 0.0]), np.zeros((9, 2)), dt_s=DT_S, rtol=1e-9, atol=1e-9)
