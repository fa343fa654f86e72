"""Laws of mechanics that the simulated arms obey in every state."""

from pathlib import Path

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from omegaconf import OmegaConf

from lagsplat.systems.arm import Arm, build_arm
from lagsplat.systems.chain import ATMOSPHERE_PA, chain_inertia, chamber_volumes
from lagsplat.systems.config import ArmConfig
from lagsplat.systems.simulate import integrate

FOLDER = Path(__file__).resolve().parents[2] / "conf" / "simulation"
DT_S = 1001 / 60000


def arm_of(name: str, **changes: object) -> Arm:
    values = OmegaConf.load(FOLDER / f"{name}.yaml").arm
    return build_arm(OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(ArmConfig), values, changes)))


def vectors(limit_bend: float, limit_strain: float) -> st.SearchStrategy[np.ndarray]:
    bend, strain = st.floats(-limit_bend, limit_bend), st.floats(-limit_strain, limit_strain)
    return st.tuples(bend, strain, bend, strain).map(np.array)


positions = vectors(1.6, 0.35)
velocities = vectors(8.0, 3.0)
pressures = st.tuples(*[st.floats(0, 0.94)] * 4).map(np.array)


@pytest.fixture(scope="module", params=["krauss_1seg", "krauss_2seg"])
def arm(request):
    return arm_of(request.param)


def coriolis(arm: Arm, q: np.ndarray, v: np.ndarray) -> np.ndarray:
    """Coriolis and centrifugal force, by which the compiled accelerations are computed."""
    return chain_inertia(q, v, arm.table, arm.gravity)[1]


def mass_slopes(arm: Arm, q: np.ndarray) -> np.ndarray:
    """``[k, i, j] = dM_ij / dq_k``, fourth-order central differences."""
    step, slopes = 1e-3, []
    for e in step * np.eye(arm.d):
        near, far = arm.mass(q + e) - arm.mass(q - e), arm.mass(q + 2 * e) - arm.mass(q - 2 * e)
        slopes.append((8 * near - far) / (12 * step))
    return np.array(slopes)


@settings(max_examples=50, deadline=None)
@given(q=positions)
def test_mass_is_symmetric_and_positive_definite(arm, q):
    mass = arm.mass(q[: arm.d])
    np.testing.assert_allclose(mass, mass.T, atol=1e-15)
    assert np.linalg.eigvalsh(mass)[0] > 1e-6


@settings(max_examples=50, deadline=None)
@given(q=positions, v=velocities)
def test_coriolis_force_is_that_of_the_christoffel_symbols(arm, q, v):
    q, v = q[: arm.d], v[: arm.d]
    slopes = mass_slopes(arm, q)
    expected = np.einsum("kij,k,j->i", slopes, v, v) - 0.5 * np.einsum("kij,i,j->k", slopes, v, v)
    np.testing.assert_allclose(coriolis(arm, q, v), expected, atol=1e-8 * (1 + v @ v))


@settings(max_examples=50, deadline=None)
@given(q=positions, v=velocities)
def test_coriolis_forces_do_half_the_work_of_the_changing_mass(arm, q, v):
    q, v = q[: arm.d], v[: arm.d]
    rate = np.einsum("kij,k,i,j->", mass_slopes(arm, q), v, v, v)
    assert v @ coriolis(arm, q, v) == pytest.approx(0.5 * rate, abs=1e-8 * (1 + v @ v) ** 1.5)


@settings(max_examples=50, deadline=None)
@given(q=positions, pressure=pressures)
def test_static_force_is_the_gradient_of_energy_less_pressure_times_volume(arm, q, pressure):
    q, pressure = q[: arm.d], pressure[: arm.d]

    def enthalpy(x: np.ndarray) -> float:
        return (
            arm.potential_energies(x[None])[0] - ATMOSPHERE_PA * pressure @ chamber_volumes(x, arm.table)[0]
        )

    step = 1e-3
    slope = [
        (8 * (enthalpy(q + e) - enthalpy(q - e)) - enthalpy(q + 2 * e) + enthalpy(q - 2 * e)) / (12 * step)
        for e in step * np.eye(arm.d)
    ]
    np.testing.assert_allclose(arm.static_force(q, pressure), -np.array(slope), atol=1e-7)


@settings(max_examples=50, deadline=None)
@given(q=positions, v=velocities, pressure=pressures)
def test_power_balance(arm, q, v, pressure):
    """``d(T + V)/dt = p . dvolume/dt - v D v``."""
    q, v, pressure = q[: arm.d], v[: arm.d], pressure[: arm.d]
    acceleration = arm.acceleration(q, v, pressure)
    gained = v @ (arm.mass(q) @ acceleration + coriolis(arm, q, v)) - v @ arm.static_force(q, np.zeros(arm.d))
    work = v @ (arm.static_force(q, pressure) - arm.static_force(q, np.zeros(arm.d)))
    assert gained == pytest.approx(work - v @ arm.damping() @ v, rel=1e-9, abs=1e-9)


@settings(max_examples=50, deadline=None)
@given(q=positions, v=velocities, pressure=pressures)
def test_mirror_image(arm, q, v, pressure):
    q, v, pressure = q[: arm.d], v[: arm.d], pressure[: arm.d]
    mirror = np.tile([-1.0, 1.0], arm.d // 2)
    swapped = pressure.reshape(-1, 2)[:, ::-1].ravel()
    image = arm.acceleration(mirror * q, mirror * v, swapped)
    np.testing.assert_allclose(image, mirror * arm.acceleration(q, v, pressure), rtol=1e-9, atol=1e-7)


@settings(max_examples=5, deadline=None)
@given(q=vectors(1.0, 0.2), v=vectors(3.0, 0.5))
def test_energy_is_conserved_without_damping_and_lost_with_it(q, v):
    free = np.zeros((60, 4))
    for retardation_s in (0.0, 0.01):
        arm = arm_of("krauss_2seg", retardation_s=retardation_s)
        path = integrate(arm, q, v, free, dt_s=DT_S, rtol=1e-10, atol=1e-12)
        kinetic = np.array([0.5 * v @ arm.mass(q) @ v for q, v in zip(*path, strict=True)])
        energy = kinetic + arm.potential_energies(path[0])
        swing = np.ptp(kinetic) + 1e-6
        if retardation_s == 0:
            np.testing.assert_allclose(energy, energy[0], atol=1e-7 * swing)
        else:
            assert np.all(np.diff(energy) <= 1e-9 * swing)


def test_the_mass_depends_on_the_state(arm):
    """Stretched against rest: the inertia about the clamp grows as the arm reaches further down."""
    rest = arm.equilibrium(np.zeros(arm.d))
    stretched = arm.equilibrium(np.full(arm.d, 0.8))
    assert arm.mass(stretched)[0, 0] > 1.4 * arm.mass(rest)[0, 0]
