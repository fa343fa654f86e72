"""The weak form of a residual, and what an ensemble and tests of terms make of it."""

from dataclasses import replace

import numpy as np
import pytest

from benchmarks.gap_baselines import discrepancy_test, sindy
from benchmarks.gap_baselines.residual import Residual, Term, Weak, compute_weak_form

TIME = np.linspace(0.0, 20.0, 1000)
MOTION = np.sin(6.0 * TIME) + 0.5 * np.sin(9.7 * TIME)


def residual(force: np.ndarray, *, noise: float = 0.0) -> Residual:
    """The speed that an unexplained ``force`` (N,) makes along a motion, with four terms."""
    rate = np.gradient(MOTION, TIME)
    terms = (
        Term("viscous_damping", rate),
        Term("coulomb_friction", np.tanh(rate / 0.1)),
        Term("linear_stiffness", -36.0 * MOTION),
        Term("input_gain", np.zeros_like(TIME), "u0"),
    )
    speed = np.cumsum(force) * (TIME[1] - TIME[0])
    speed += noise * np.random.default_rng(3).standard_normal(len(TIME))
    return Residual(TIME, np.array([[0, len(TIME)]]), speed[:, None], (terms,), np.array([36.0]), 1.0)


def weak(force: np.ndarray, *, noise: float = 0.0) -> Weak:
    return compute_weak_form(residual(force, noise=noise), 0, periods=0.5)


def test_a_term_that_is_zero_in_every_stretch_is_left_out() -> None:
    form = weak(np.zeros_like(TIME))
    assert [term.name for term in form.terms] == ["viscous_damping", "coulomb_friction", "linear_stiffness"]
    assert form.features.shape == (len(form.rate), 3)


def test_means_of_the_speed_are_means_of_the_acceleration() -> None:
    form = weak(-0.7 * np.gradient(MOTION, TIME))
    coefficients = np.linalg.lstsq(form.features, form.rate, rcond=None)[0]
    assert coefficients == pytest.approx([-0.7, 0.0, 0.0], abs=0.02)


def test_stretches_whose_samples_were_lost_are_left_out() -> None:
    whole = residual(-np.tanh(np.gradient(MOTION, TIME) / 0.1))
    keep = (TIME < 8.0) | (TIME > 11.0)
    terms = tuple(replace(term, values=term.values[keep]) for term in whole.terms[0])
    count = np.array([[0, np.count_nonzero(keep)]])
    part = replace(whole, time_s=TIME[keep], clips=count, speed=whole.speed[keep], terms=(terms,))
    form = compute_weak_form(part, 0, periods=0.5)
    assert np.isfinite(form.features).all()
    assert len(form.rate) < len(compute_weak_form(whole, 0, periods=0.5).rate)


def test_a_clip_that_is_too_short_has_no_weak_form() -> None:
    short = replace(residual(np.zeros_like(TIME)), clips=np.array([[0, 10]]))
    with pytest.raises(ValueError, match="record longer"):
        compute_weak_form(short, 0, periods=0.5)


def test_planted_friction_is_included_and_significant() -> None:
    form = weak(-3.0 * np.tanh(np.gradient(MOTION, TIME) / 0.1), noise=0.003)
    kept = sindy.choose_terms(sindy.fit_ensembles([form], np.array([36.0]), ["q0"], seed=1))
    assert [term.place.name for term in kept] == ["coulomb_friction"]
    assert np.median(kept[0].coefficients) == pytest.approx(-3.0, rel=0.1)
    clean = weak(np.zeros_like(TIME), noise=0.003)
    assert discrepancy_test.find_suspects([form], [clean]) == [0]
    chosen, _ = discrepancy_test.choose_terms([form], [0], np.array([36.0]))
    assert form.terms[chosen[0].term].name == "coulomb_friction"


def test_noise_is_none() -> None:
    form = weak(np.zeros_like(TIME), noise=0.003)
    terms = sindy.fit_ensembles([form], np.array([36.0]), ["q0"], seed=1)
    assert sindy.choose_terms(terms) == []
    weights = sindy.weigh_terms(terms)
    assert max(weights, key=lambda name: weights[name]) == "none"
    chosen, _ = discrepancy_test.choose_terms([form], [0], np.array([36.0]))
    assert chosen == []
