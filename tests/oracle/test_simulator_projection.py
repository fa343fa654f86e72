"""Sims that are given point by point, against the equations they were written from."""

import numpy as np
import pytest

from lagsplat.diagnose.core.config import ESTIMATION
from lagsplat.diagnose.estimation.dataset import Dataset, OperatingRegion, sample_operating_region
from lagsplat.diagnose.simulators.projection import FieldFunctions, ProjectedModel, project_fields
from lagsplat.diagnose.simulators.projection_acceleration import project_acceleration

LENGTH, GRAVITY = 0.35, 9.81


def swing(d: int, n_u: int, reach: float) -> Dataset:
    """A motion of ``d`` coordinates at rates that share no multiple, and inputs beside it."""
    time = np.arange(900) / 60.0
    rate = 2.0 * np.pi * np.sqrt(np.arange(1.0, d + 1.0))
    q = reach * np.cos(np.outer(time, rate) + np.arange(d)) * np.exp(-time / 20.0)[:, None]
    u = np.sin(np.outer(time, 3.0 * np.arange(1.0, n_u + 1.0)))
    clips = np.array([[0, len(time)]])
    return Dataset(
        time, q, np.gradient(q, time, axis=0), u, clips, ("a",), np.zeros(1, dtype=np.int64), (0.0,), q
    )


def double_pendulum() -> FieldFunctions:
    """Two equal points on rods of equal length, absolute angles, a motor between the rods."""

    def mass(q: np.ndarray) -> np.ndarray:
        c = np.cos(q[:, 0] - q[:, 1])
        return LENGTH**2 * np.moveaxis(np.array([[2.0 + 0.0 * c, c], [c, 1.0 + 0.0 * c]]), 2, 0)

    return FieldFunctions(
        mass=mass,
        potential_gradient=lambda q: GRAVITY * LENGTH * np.sin(q) * np.array([2.0, 1.0]),
        input_map=lambda q: np.tile([[[1.0, -1.0]]], (len(q), 1, 1)),
        dissipation=lambda q, v: 0.02 * v,
    )


def textbook(q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
    """The double pendulum's acceleration as textbooks write it, solved by hand with Cramer's rule."""
    c, s = np.cos(q[:, 0] - q[:, 1]), np.sin(q[:, 0] - q[:, 1])
    f0 = u[:, 0] - 0.02 * v[:, 0] - LENGTH**2 * s * v[:, 1] ** 2
    f0 = f0 - 2.0 * GRAVITY * LENGTH * np.sin(q[:, 0])
    f1 = -u[:, 0] - 0.02 * v[:, 1] + LENGTH**2 * s * v[:, 0] ** 2 - GRAVITY * LENGTH * np.sin(q[:, 1])
    det = LENGTH**2 * (2.0 - c * c)
    return np.stack([(f0 - c * f1) / det, (2.0 * f1 - c * f0) / det], axis=1)


def worst(one: ProjectedModel, region: OperatingRegion, truth: np.ndarray) -> float:
    wrong = one.model.acceleration(region.q, region.v, region.u) - truth
    return float(np.abs(wrong).max() / np.abs(truth).max())


@pytest.mark.parametrize(("reach", "bound"), [(0.25, 0.005), (0.7, 1e-5), (2.5, 1e-5)])
def test_a_double_pendulum_is_found_from_its_fields(reach: float, bound: float) -> None:
    region = sample_operating_region(swing(2, 1, reach))
    one = project_fields(double_pendulum(), region, what="sim")
    fresh = sample_operating_region(swing(2, 1, reach), seed=1)
    assert worst(one, fresh, textbook(fresh.q, fresh.v, fresh.u)) < bound
    assert one.error < bound
    np.testing.assert_allclose(one.model.rest, 0.0, atol=1e-6)
    # inertia is counted in units of its own: only ratios are left
    np.testing.assert_allclose(one.model.inertia[0, 0] / one.model.inertia[1, 1], 2.0, rtol=2e-3)


@pytest.mark.parametrize("reach", [0.7, 2.5])
def test_a_double_pendulum_is_found_from_its_acceleration_alone(reach: float) -> None:
    region = sample_operating_region(swing(2, 1, reach))
    one = project_acceleration(textbook, region, what="sim")
    fresh = sample_operating_region(swing(2, 1, reach), seed=1)
    assert worst(one, fresh, textbook(fresh.q, fresh.v, fresh.u)) < 1e-4
    assert np.trace(one.model.mass[0]) == pytest.approx(2.0)
    # what a push does is known too, not only how it moves by itself
    ratio = one.model.inertia / one.model.inertia[1, 1]
    np.testing.assert_allclose(ratio, [[2.0, 1.0], [1.0, 1.0]], atol=1e-3)


def test_friction_and_drag_are_told_from_damping() -> None:
    region = sample_operating_region(swing(1, 1, 0.7))
    sliding = project_acceleration(lambda q, v, u: -40.0 * q - 3.0 * np.sign(v) + u, region, what="sim")
    assert sliding.model.dry[0] == pytest.approx(3.0, rel=0.05)
    assert sliding.model.damping[0, 0, 0] == pytest.approx(0.0, abs=0.1)
    dragged = project_acceleration(lambda q, v, u: -40.0 * q - 0.3 * np.abs(v) * v, region, what="sim")
    assert dragged.model.drag[0] == pytest.approx(0.3, rel=1e-6)
    assert dragged.model.dry[0] == 0.0


def test_an_unforced_model_loses_energy_by_its_losses_alone() -> None:
    region = sample_operating_region(swing(2, 1, 0.7))
    model = project_acceleration(textbook, region, what="sim").model
    q, v = region.q, region.v
    a = model.acceleration(q, v, np.zeros_like(region.u))
    step = 1e-5

    def energy(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        kinetic = 0.5 * np.einsum("ni,nij,nj->n", v, model.mass_at(q), v)
        return kinetic + model.basis.first(len(model.potential)).values(q) @ model.potential

    rate = (energy(q + step * v, v + step * a) - energy(q - step * v, v - step * a)) / (2.0 * step)
    lost = -0.02 / LENGTH**2 * np.sum(v * v, axis=1) * model.inertia[1, 1]
    np.testing.assert_allclose(rate, lost, atol=1e-3 * np.abs(rate).max() + 1e-6)


def test_what_cannot_be_written_is_told() -> None:
    region = sample_operating_region(swing(1, 1, 0.7))
    with pytest.warns(UserWarning, match=r"sim: its acceleration .* only to within"):
        project_acceleration(lambda q, v, u: -40.0 * q + 20.0 * u * np.abs(u), region, what="sim")
    with pytest.raises(ValueError, match="not finite at q"):
        project_acceleration(lambda q, v, u: np.where(q > 0.5, np.nan, -q), region, what="sim")
    with pytest.raises(ValueError, match="zero everywhere"):
        project_acceleration(lambda q, v, u: 0.0 * q, region, what="sim")
    heavy = double_pendulum()
    without = FieldFunctions(
        lambda q: -heavy.mass(q), heavy.potential_gradient, heavy.input_map, heavy.dissipation
    )
    with pytest.raises(ValueError, match="not positive at q"):
        project_fields(without, sample_operating_region(swing(2, 1, 0.7)), what="sim")


def test_a_region_covers_the_record_and_a_margin() -> None:
    record = swing(2, 1, 1.0)
    region = sample_operating_region(record)
    half = 0.5 * np.ptp(record.q, axis=0)
    assert (np.ptp(region.q, axis=0) > 2.0 * half).all()
    assert (np.ptp(region.q, axis=0) < 2.0 * half * (1.0 + 2.0 * ESTIMATION.region_margin)).all()
    still = Dataset(
        record.time,
        record.q,
        record.v,
        0.0 * record.u,
        record.clips,
        ("a",),
        record.file_of,
        (0.0,),
        record.q,
    )
    assert np.ptp(sample_operating_region(still).u) > 0.5
