import numpy as np
import pytest
from scipy.optimize import brentq

from lagsplat.systems.arm import build_arm


def test_small_angles_of_one_segment_follow_the_hand_formula(load):
    """Frequencies of an arc ``x = l theta s^2 / 2`` with an axial spring, worked out by hand."""
    c = load("krauss_1seg").arm
    k, h, length, mass = c.extension_stiffness[0], c.extension_hardening, c.length[0], c.mass[0]
    tip, cap, g, gyration = c.link_mass[0], c.link_length[0], c.gravity, c.half_width**2 / 3
    strain = brentq(lambda e: k * e * (1 + h * e**2) - (mass / 2 + tip) * g * length, 0, 1, xtol=1e-15)
    stretched = length * (1 + strain)
    inertia = mass * (stretched**2 / 20 + gyration / 3)
    inertia += tip * ((stretched / 2 + cap / 2) ** 2 + cap**2 / 12 + gyration)
    weight = g * (mass * stretched / 12 + tip * (stretched / 3 + cap / 2))
    bending = np.sqrt((c.bending_stiffness[0] + weight) / inertia)
    axial = np.sqrt(k * (1 + 3 * h * strain**2) / ((mass / 3 + tip) * length**2))
    arm = build_arm(c)
    np.testing.assert_allclose(arm.equilibrium(np.zeros(2)), [0, strain], atol=1e-10)
    modes = arm.modes()
    np.testing.assert_allclose(modes.natural_hz, np.array([bending, axial]) / (2 * np.pi), rtol=1e-7)
    decay = (
        0.5
        * c.retardation_s
        * np.array([c.bending_stiffness[0] / inertia, (axial**2) / (1 + 3 * h * strain**2)])
    )
    np.testing.assert_allclose(modes.decay_per_s, decay, rtol=1e-7)
    np.testing.assert_allclose(
        modes.damped_hz, np.sqrt(modes.natural_hz**2 - (decay / 2 / np.pi) ** 2), rtol=1e-9
    )


@pytest.mark.parametrize(
    ("name", "slowest_hz", "ratio"), [("krauss_2seg", 1.566, 0.03), ("krauss_1seg", 4.63, 0.05)]
)
def test_the_stand_ins_have_the_real_slowest_mode(load, name, slowest_hz, ratio):
    modes = build_arm(load(name).arm).modes()
    assert modes.damped_hz[0] == pytest.approx(slowest_hz, rel=2e-3)
    assert modes.damping_ratio[0] == pytest.approx(ratio, rel=0.15)
    assert modes.damped_hz[-1] < 15
    assert np.all(modes.decay_per_s[1:] > 10 / 2 * modes.decay_per_s[0])


@pytest.mark.parametrize("name", ["krauss_1seg", "krauss_2seg"])
def test_equal_pressures_extend_and_unequal_bend(load, name):
    arm = build_arm(load(name).arm)
    still = arm.equilibrium(np.zeros(arm.d))
    equal = arm.equilibrium(np.full(arm.d, 0.5))
    np.testing.assert_allclose(equal[0::2], 0, atol=1e-9)
    assert np.all(equal[1::2] > still[1::2] + 0.05)
    left = np.zeros(arm.d)
    left[0] = 0.5
    bent = arm.equilibrium(left)
    assert bent[0] > np.radians(8)
    np.testing.assert_allclose(
        arm.equilibrium(left.reshape(-1, 2)[:, ::-1].ravel())[0::2], -bent[0::2], atol=1e-9
    )


def test_an_arm_too_weak_to_stand_on_its_head_is_refused(load):
    arm = build_arm(load("toy", arm={"bending_stiffness": [0.01], "gravity": -9.81}).arm)
    with pytest.raises(ValueError, match="no stable rest pose"):
        arm.equilibrium(np.zeros(2))
