"""A wrong law is moved to tell its own recordings, and only what differs from these is an effect."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.diagnose.core.config import RECALIBRATION
from lagsplat.diagnose.diagnosis import diagnose
from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator
from lagsplat.diagnose.inference.recalibration import (
    calibrate_misfit,
    choose_structure,
    recalibrate_simulator,
)
from lagsplat.diagnose.mechanics.model import MechanicalModel
from tests.unit.diagnose.toys import HARD, RATE, film, oscillator, own, settings, wave


def damped(t: float, q: float, v: float, u: float, z: np.ndarray) -> tuple[float, list[float]]:
    """The oscillator with more damping."""
    return own(q, v, u) - 0.5 * v, []


def wrong() -> MechanicalModel:
    """A law as a poor fit leaves it: too hard, too little damped, and the input a little weak."""
    right = oscillator(hard=1.3 * HARD)
    return replace(right, damping=0.5 * right.damping, input_map=0.95 * right.input_map)


@pytest.fixture(scope="module")
def known() -> EstimatedSimulator:
    """The wrong law, moved by a recording of the very oscillator, and held to another one."""
    recordings = [film(u=wave(1), noise=0.01, seed=1, seconds=40.0)]
    null = [film(u=wave(2), noise=0.01, seed=2, seconds=20.0)]
    given = calibrate_misfit(EstimatedSimulator.exact(wrong()), null, settings())
    return calibrate_misfit(recalibrate_simulator(given, recordings, settings()), null, settings())


def test_a_wrong_law_is_moved_until_it_tells_what_it_was_not_moved_by(known: EstimatedSimulator) -> None:
    assert known.original is not None
    assert known.original.misfit > 1.2 * known.misfit
    assert known.misfit < 1.3
    assert known.model.damping[0, 0, 0] == pytest.approx(RATE, rel=0.05)
    assert known.model.potential[4] == pytest.approx(0.25 * HARD, rel=0.1)


def test_a_law_whose_rollouts_run_off_in_windows_that_judge_is_moved_by_the_others() -> None:
    """Beyond some swing its spring pushes away."""
    told = [film(u=wave(1), noise=0.01, seed=1, seconds=40.0)]
    given = EstimatedSimulator.exact(oscillator(hard=-0.6 * HARD))
    assert calibrate_misfit(given, told, settings()).misfit > 100.0
    moved = calibrate_misfit(recalibrate_simulator(given, told, settings()), told, settings())
    assert moved.misfit < 1.3


def test_a_right_law_stays_as_it_is() -> None:
    sim = EstimatedSimulator.exact(oscillator())
    assert recalibrate_simulator(sim, [film(u=wave(1), noise=0.01, seed=1, seconds=20.0)], settings()) is sim


def test_what_the_law_lacked_is_no_effect_and_what_is_new_is(known: EstimatedSimulator) -> None:
    same = diagnose(known, [film(u=wave(4), noise=0.01, seed=4, seconds=16.0)], settings()).diagnosis
    assert same.verdict == "none"
    new = diagnose(known, [film(damped, u=wave(5), noise=0.01, seed=5, seconds=16.0)], settings()).diagnosis
    assert new.combination == ("viscous_damping",)
    assert new.gap is not None
    assert new.gap.after < 0.5 * new.gap.before


def test_a_release_that_it_never_saw_is_left_aside_and_told(known: EstimatedSimulator) -> None:
    driven, free = (
        film(u=wave(1), noise=0.01, seed=1, seconds=20.0),
        film(noise=0.01, seed=6, start=(4.0, 0.0), seconds=4.0),
    )
    released = replace(free, u=np.zeros((free.n, 1)), u_names=driven.u_names)
    told = diagnose(known, [driven, released], settings()).diagnosis
    assert any("left aside" in text and "release" in text for text in told.warnings)
    assert told.verdict == "none"
    assert all(block.file == driven.source for block in told.blocks)


def test_a_mass_moves_only_as_a_whole() -> None:
    form = choose_structure(oscillator(), RECALIBRATION.degree_steps[0])
    assert (form.mass, form.damping, form.potential, form.input_map) == (1, 1, 5, 1)
