"""What a diagnosis must not depend on: clocks, units, names, the scale of inertia, the coordinates chosen."""

import math
from collections.abc import Callable
from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from lagsplat.diagnose.core.result import Diagnosis
from lagsplat.diagnose.diagnosis import diagnose
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator, estimate_simulator
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.toys import coupled, film, oscillator, own, settings, wave

RIVALS = ("coulomb_friction", "quadratic_drag", "cubic_stiffness", "viscous_damping", "input_lag", "creep")
U = wave(4)


def told(sim: EstimatedSimulator, real: list[Trajectory], *, places: int = 1) -> Diagnosis:
    """The diagnosis among a few effects, each at so many places."""
    left_out = sorted(set(catalogue()) - set(RIVALS))
    config = replace(settings(), without=left_out, always_fitted=[], families=3, starts=1, places=places)
    return diagnose(sim, real, config).diagnosis


def rubbing(t: float, q: float, v: float, u: float, z: np.ndarray) -> tuple[float, list[float]]:
    """With Coulomb friction."""
    return own(q, v, u) - 3.0 * math.tanh(v / 0.02), []


@pytest.fixture(scope="module")
def real() -> Trajectory:
    return film(rubbing, u=U, seconds=9.0, noise=0.005)


@pytest.fixture(scope="module")
def usual(real: Trajectory) -> Diagnosis:
    found = told(EstimatedSimulator.exact(oscillator()), [real])
    assert found.verdict == "effect"
    assert found.combination == ("coulomb_friction",)
    return found


def assert_same(one: Diagnosis, other: Diagnosis, *, unit: float = 1.0, within: float = 0.02) -> None:
    assert (one.verdict, one.combination) == (other.verdict, other.combination)
    assert one.gap is not None
    assert other.gap is not None
    assert other.gap.closure.value == pytest.approx(one.gap.closure.value, abs=within)
    size, same = (d.candidates[0].parameters["acceleration"].value for d in (one, other))
    assert same == pytest.approx(unit * size, rel=0.05)


def moved(model: MechanicalModel, factor: float, shift: float) -> MechanicalModel:
    """The same mechanism in coordinates ``factor q + shift``."""
    basis = replace(
        model.basis, centre=factor * model.basis.centre + shift, scale=abs(factor) * model.basis.scale
    )
    odd = np.where(model.basis.order[:, 0] % 2 == 1, np.sign(factor), 1.0)
    return replace(
        model,
        basis=basis,
        mass=model.mass / factor**2,
        damping=model.damping / factor**2,
        potential=model.potential * odd,
        input_map=model.input_map / factor,
        width=abs(factor) * model.width,
        rest=factor * model.rest + shift,
    )


def test_the_scale_of_inertia_moves_nothing(real: Trajectory, usual: Diagnosis) -> None:
    """M, C, V and b times the same number are the same mechanism."""
    model = oscillator()
    names = ("mass", "damping", "potential", "input_map", "dry", "drag")
    heavy = replace(model, **{name: 7.3 * getattr(model, name) for name in names})
    found = told(EstimatedSimulator.exact(heavy), [real])
    assert_same(usual, found, within=1e-3)
    assert found.candidates[0].log_evidence == pytest.approx(usual.candidates[0].log_evidence, abs=0.1)


def test_the_clock_may_begin_anywhere(real: Trajectory, usual: Diagnosis) -> None:
    assert_same(
        usual,
        told(EstimatedSimulator.exact(oscillator()), [replace(real, time_s=real.time_s + 1234.5)]),
        within=1e-3,
    )


@pytest.mark.parametrize(("factor", "shift"), [(57.3, 0.0), (0.01, 3.0), (-1.0, 0.2)])
def test_units_and_origin_of_the_coordinate_move_nothing(
    real: Trajectory, usual: Diagnosis, factor: float, shift: float
) -> None:
    other = replace(real, q=factor * real.q + shift)
    assert_same(
        usual, told(EstimatedSimulator.exact(moved(oscillator(), factor, shift)), [other]), unit=abs(factor)
    )


def test_the_order_of_coordinates_and_inputs_moves_nothing() -> None:
    """A coupled pair with drag on the second joint."""
    model = replace(coupled(), dry=np.zeros(2), drag=np.zeros(2))
    one = pair(model, lambda q, v: np.array([0.0, -0.6 * abs(v[1]) * v[1]]))
    swapped = replace(
        one, q=one.q[:, ::-1], u=one.u[:, ::-1], q_names=one.q_names[::-1], u_names=one.u_names[::-1]
    )
    basis = replace(model.basis, order=model.basis.order[:, ::-1].copy())
    # each field keeps the functions it has, so that those of degree one need to change places with their rows
    turned = np.arange(basis.size)
    turned[[1, 2]] = 2, 1
    basis = replace(basis, kind=basis.kind[turned], order=basis.order[turned])
    other = replace(
        model,
        basis=basis,
        mass=model.mass[turned][:, ::-1, ::-1].copy(),
        damping=model.damping[turned[:3]][:, ::-1, ::-1].copy(),
        potential=model.potential[turned],
        input_map=model.input_map[turned[:3]][:, ::-1, ::-1].copy(),
    )
    first, second = (
        told(EstimatedSimulator.exact(model), [one], places=2),
        told(EstimatedSimulator.exact(other), [swapped], places=2),
    )
    assert first.combination == second.combination == ("quadratic_drag",)
    assert first.candidates[0].coordinate == second.candidates[0].coordinate == "q1"
    assert first.gap is not None
    assert second.gap is not None
    assert second.gap.closure.value == pytest.approx(first.gap.closure.value, abs=0.02)


def pair(model: MechanicalModel, further: Callable[[np.ndarray, np.ndarray], np.ndarray]) -> Trajectory:
    """A motion of two coordinates under a further generalised force."""
    time, waves = np.arange(400) / 40, (wave(1), wave(2))

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        now = np.array([[w(t) for w in waves]])
        force = model.force(x[None, :2], x[None, 2:], now)[0] + further(x[:2], x[2:])
        return np.concatenate([x[2:], np.linalg.solve(model.mass_at(x[None, :2])[0], force)])

    y = solve_ivp(rate, (0.0, time[-1]), [0.5, -0.4, 0.0, 0.6], t_eval=time, rtol=1e-7, atol=1e-9).y[:2].T
    y = y + 0.005 * y.std(axis=0) * np.random.default_rng(0).standard_normal(y.shape)
    return Trajectory(time, y, np.array([[w(t) for w in waves] for t in time]), source="pair")


def test_names_are_names(real: Trajectory, usual: Diagnosis) -> None:
    found = told(
        EstimatedSimulator.exact(oscillator()), [replace(real, q_names=("elbow",), u_names=("torque",))]
    )
    assert_same(usual, found, within=1e-9)
    assert found.candidates[0].coordinate == "elbow"
    assert "elbow" in found.candidates[0].parameters["acceleration"].unit


def test_a_mild_bend_of_the_coordinate_moves_nothing(real: Trajectory) -> None:
    """Where the sim is known from its own recordings in the same coordinates."""
    nominal = film(u=wave(7), seconds=14.0, noise=0.005, seed=3)
    size = np.abs(real.q).max()

    def bent(one: Trajectory) -> Trajectory:
        return replace(one, q=one.q + 0.08 * one.q**2 / size)

    plain = told(estimate_simulator([nominal], settings()), [real])
    assert plain.combination == ("coulomb_friction",)
    assert_same(plain, told(estimate_simulator([bent(nominal)], settings()), [bent(real)]))


def test_a_faithful_sim_lacks_nothing_and_there_is_no_gap_to_close() -> None:
    for seed in range(3):
        found = told(EstimatedSimulator.exact(oscillator()), [film(u=wave(seed), noise=0.01, seed=seed)])
        assert found.verdict == "none"
        assert found.candidates[0].name == "none"
        assert found.combination == ()
        assert found.gap is not None
        assert found.gap.closure.value is None
        assert found.gap.before == pytest.approx(found.gap.floor, rel=0.3)


def test_the_gap_of_the_exact_augmented_sim_is_closed_whole(usual: Diagnosis) -> None:
    assert usual.gap is not None
    assert usual.gap.before > 3.0 * usual.gap.floor
    assert usual.gap.closure.value == pytest.approx(1.0, abs=0.02)
    assert usual.gap.closure.low <= 1.0 <= usual.gap.closure.high + 0.01


def test_probabilities_add_up_and_stand_in_order(usual: Diagnosis) -> None:
    weights = [one.probability for one in usual.candidates]
    assert sum(weights) == pytest.approx(1.0)
    assert weights == sorted(weights, reverse=True)
    assert {one.name for one in usual.candidates} == {*RIVALS, "none", "unknown"}
