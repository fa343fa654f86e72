"""The weak equations hold of a true motion, and their regression gives the coefficients back."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from lagsplat.diagnose.estimation.dataset import Dataset
from lagsplat.diagnose.identification.weak_form import (
    build_model,
    build_regressors,
    build_weak_form_samples,
    fit_explicit_model,
    solve_ridge,
)
from lagsplat.diagnose.mechanics.basis import add_angle_functions, make_polynomial_basis
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.mechanics.structure import (
    ModelStructure,
    build_candidate_bases,
    flatten_coefficients,
    list_field_sizes,
    list_free_directions,
    list_larger_structures,
    pad_model,
    shift_coefficients,
)
from tests.unit.diagnose.toys import GAIN, HARD, OMEGA, RATE, coupled, film, oscillator, wave


def recorded(model: MechanicalModel, start: list[float], *, seconds: float, u: list) -> Dataset:
    """A true motion of a model with smooth inputs, and its true velocities."""
    d, time = model.d, np.arange(round(seconds * 100)) / 100

    def rate(t: float, x: np.ndarray) -> np.ndarray:
        now = np.array([[one(t) for one in u]])
        return np.concatenate([x[d:], model.acceleration(x[None, :d], x[None, d:], now)[0]])

    y = solve_ivp(rate, (0.0, time[-1]), start, t_eval=time, rtol=1e-7, atol=1e-8).y.T
    inputs = np.array([[one(t) for one in u] for t in time])
    cut = len(time) // 2 - 7
    clips = np.array([[0, cut], [cut, len(time)]])
    q, v, file_of = y[:, :d], y[:, d:], np.zeros(2, np.int64)
    return Dataset(time, q, v, inputs, clips, ("made",), file_of, (0.0,), q)


def test_test_functions_stay_within_clips_and_integrate_to_nothing_in_their_rate() -> None:
    record = recorded(oscillator(), [0.8, 0.0], seconds=6.0, u=[wave()])
    samples = build_weak_form_samples(
        make_polynomial_basis(4, centre=np.zeros(1), scale=np.ones(1)),
        3,
        record,
        width_s=0.5,
        speed=np.ones(1),
    )
    assert len(samples.tests) > 20
    for at, psi, rate in samples.tests:
        assert sum(start <= at.start and at.stop <= stop for start, stop in record.clips) == 1
        assert psi.min() >= 0.0
        assert abs(rate.sum()) < 1e-6
        times = record.time[at]
        assert rate @ times == pytest.approx(-psi.sum(), rel=1e-4)  # by parts


def test_the_weak_equations_hold_of_a_coupled_mechanism_with_constant_inertia_and_damping() -> None:
    full = coupled()
    constant = {name: getattr(full, name)[:1] for name in ("mass", "damping", "input_map")}
    model = replace(full, **constant, dry=np.zeros(2), drag=np.zeros(2))
    record = recorded(model, [0.5, -0.4, 0.0, 0.6], seconds=4.0, u=[wave(), wave(1)])
    n = len(model.potential)
    samples = build_weak_form_samples(model.basis, n, record, width_s=0.6, speed=model.width)
    rows, known = build_regressors(samples)
    # in units in which the trace of the constant inertia is d
    mass, damping, potential = (
        field / (np.trace(model.mass[0]) / 2) for field in (model.mass[0], model.damping[0], model.potential)
    )
    pairs = np.triu_indices(2)
    gains = model.input_map[0].ravel() / (np.trace(model.mass[0]) / 2)
    truth = np.concatenate([[mass[0, 0] - 1.0, mass[0, 1]], potential[1:], damping[pairs], gains])
    assert np.abs(rows @ truth - known).max() < 2e-4 * np.abs(known).max()
    found = build_model(samples, truth)
    states = record.q, record.v, record.u
    assert found.acceleration(*states) == pytest.approx(model.acceleration(*states), rel=1e-9, abs=1e-9)


def test_an_oscillator_is_given_back_from_its_motion() -> None:
    model = oscillator()
    record = recorded(model, [0.8, 0.0], seconds=6.0, u=[wave()])
    samples = build_weak_form_samples(model.basis, model.basis.size, record, width_s=0.5, speed=np.ones(1))
    rows, known = build_regressors(samples)
    found = build_model(samples, solve_ridge(rows, known, 1e-10))
    assert found.mass[0, 0, 0] == 1.0
    assert found.damping[0, 0, 0] == pytest.approx(RATE, rel=1e-3)
    assert found.input_map[0, 0, 0] == pytest.approx(GAIN, rel=1e-3)
    assert found.potential == pytest.approx([0.0, 0.0, 0.5 * OMEGA**2, 0.0, 0.25 * HARD], abs=0.02)


def test_ridge_shrinks_and_vanishes() -> None:
    rng = np.random.default_rng(0)
    rows, truth = rng.normal(size=(200, 3)) * [1.0, 1e3, 1e-3], np.array([1.0, 2e-3, -3e3])
    assert solve_ridge(rows, rows @ truth, 1e-12) == pytest.approx(truth, rel=1e-6)
    shrunk = solve_ridge(rows, rows @ truth, 1.0)
    assert (np.abs(shrunk) < 0.7 * np.abs(truth)).all()


def test_fields_grow_by_whole_degrees_and_stay_what_they_were() -> None:
    q = np.random.default_rng(0).uniform(-1.0, 1.0, (50, 2))
    plain, angles = build_candidate_bases(q, degree=3)
    assert list_field_sizes(plain) == [1, 3, 6, 10]
    assert list_field_sizes(angles)[-1] == angles.size
    model, form = coupled(), ModelStructure(1, 1, 6, 1)
    for larger in list_larger_structures(form, add_angle_functions(plain, np.array([[1, 0]])), driven=True):
        assert larger.order > form.order
    roomy = pad_model(model, ModelStructure(12, 6, 12, 6))
    states = q, np.ones((50, 2)), np.ones((50, 2))
    assert roomy.acceleration(*states) == pytest.approx(model.acceleration(*states), rel=1e-12)
    assert (
        len(build_candidate_bases(0.2 * q, degree=3)) == 1
    )  # over a small range angles are as good as polynomials


def test_every_free_direction_moves_the_acceleration_and_no_two_the_same_way() -> None:
    """The trace of the inertia, the constant of the potential and its scale are not free."""
    model, form = coupled(), ModelStructure(3, 3, 6, 3, dry=True, drag=True)
    moves = list_free_directions(model, form, np.ones(2))
    assert moves.shape[1] == len(flatten_coefficients(model))
    rng = np.random.default_rng(0)
    q, v, u = (rng.normal(0.0, 0.6, (60, 2)) for _ in range(3))
    still = model.acceleration(q, v, u)
    effect = np.array(
        [(shift_coefficients(model, 1e-5 * move).acceleration(q, v, u) - still).ravel() for move in moves]
    )
    size = np.linalg.norm(effect, axis=1)
    assert (size > 0.0).all()
    assert np.linalg.matrix_rank(effect / size[:, None], tol=1e-4) == len(moves)


def test_a_film_of_the_toy_is_that_of_the_model() -> None:
    """Two ways to the same motion: scipy on the written law, and the model's own acceleration."""
    record = recorded(oscillator(), [0.8, 0.0], seconds=3.0, u=[wave()])
    assert record.q[::2] == pytest.approx(film(u=wave(), seconds=3.0).q, abs=1e-5)


def test_accelerations_give_a_law_where_coordinates_move_together() -> None:
    """A cart without a spring and the pole that hangs from it swing as one."""
    basis = make_polynomial_basis(4, centre=np.zeros(2), scale=np.array([0.06, 0.5]))
    cart_pole = MechanicalModel(
        basis=basis,
        mass=np.array([[[2.0, 0.24], [0.24, 0.1]]]),
        damping=np.array([[[0.02, 0.0], [0.0, 0.005]]]),
        potential=np.array(
            [0.0, 0.0, 0.0, 0.0, 0.0, 0.25]
        ),  # of half the square of the angle, over 0.5 squared
        input_map=np.zeros((0, 0, 2)),
        dry=np.zeros(2),
        drag=np.zeros(2),
        width=np.ones(2),
        rest=np.zeros(2),
    )
    record = recorded(cart_pole, [-0.06, 0.5, 0.0, 0.0], seconds=20.0, u=[])
    samples = build_weak_form_samples(basis, 6, record, width_s=0.6, speed=np.ones(2))
    found = fit_explicit_model(samples, 1e-5)
    assert found is not None
    assert np.linalg.eigvalsh(found.mass[0]).min() > 0.0
    assert np.trace(found.mass[0]) == pytest.approx(2.0)
    true, own = (m.acceleration(record.q, record.v, record.u) for m in (cart_pole, found))
    assert np.abs(own - true).max() < 0.02 * np.abs(true).max()
    turning = build_candidate_bases(np.array([[-7.0, -7.0], [7.0, 7.0]]), degree=4)[0]
    around = build_weak_form_samples(turning, turning.size, record, width_s=0.6, speed=np.ones(2))
    assert fit_explicit_model(around, 1e-5) is None
