"""Explanations that would explain anything: outer forces that nothing repeats, and sims that are loose."""

import math
from dataclasses import replace

import numpy as np

from lagsplat.diagnose.core.config import IMPLAUSIBILITY
from lagsplat.diagnose.diagnosis import diagnose
from lagsplat.diagnose.effects.base import Direction, PlacedEffect
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator
from lagsplat.diagnose.inference.model_selection import ModelRanking
from lagsplat.diagnose.inference.placement import measure_largest_motion_scales, measure_motion_scales
from lagsplat.diagnose.inference.posterior import (
    Implausibility,
    assess_implausibility,
    measure_recurrence,
    relaxed_model_log_evidence,
)
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit
from tests.unit.diagnose.toys import GAIN, OMEGA, RATE, contest, film, oscillator, own, settings, wave

U = wave(2)
ALONG = Direction("q0", np.ones(1), 1.0, 0.0)


def explained(one: EstimationProblem, name: str, **unknowns: float) -> HypothesisFit:
    """The effect with parameters as given in their own units, whatever the data say."""
    instance = PlacedEffect(
        catalogue()[name], measure_motion_scales(one.rollout_model, ALONG), direction=ALONG
    )
    parameters = instance.effect.parameters
    x = [
        p.prior.unknown(unknowns.get(p.name.replace(" ", "_"), 0.0) / instance.scales.of(p.kind))
        if p.name.replace(" ", "_") in unknowns
        else p.prior.mean
        for p in parameters
    ]
    fit = one.fit((), np.zeros(one.rollout_model.nuisance.size))
    return HypothesisFit((instance,), replace(fit, x=np.concatenate([x, fit.x])))


def test_a_push_comes_from_outside_only_where_its_state_is_passed_again() -> None:
    one = contest([film(u=lambda t: math.sin(2.0 * np.pi * 0.5 * t), seconds=20.0, start=(0.0, 0.0))])
    # halfway through a motion that repeats every two seconds
    among = explained(one, "external_push", acceleration_0=2.0, time_0=10.3, duration_0=0.2)
    assert measure_recurrence(among, one) == 1.0
    swing = contest([film(seconds=12.0, start=(0.8, 0.0))])
    # the first swing, which a decaying motion never reaches again
    first = explained(swing, "external_push", acceleration_0=2.0, time_0=0.1, duration_0=0.3)
    assert measure_recurrence(first, swing) < 0.5


def test_a_periodic_force_shows_only_where_it_repeats() -> None:
    one = contest([film(seconds=12.0)])
    slow = explained(one, "external_periodic_force", cosine=1.0, angular_frequency=2.0 * np.pi / 12.0)
    quick = explained(one, "external_periodic_force", cosine=1.0, angular_frequency=2.0 * np.pi)
    assert measure_recurrence(slow, one) < 0.3
    assert measure_recurrence(quick, one) == 1.0


def test_what_depends_on_the_state_needs_no_repetition() -> None:
    one = contest([film(seconds=6.0)])
    assert measure_recurrence(explained(one, "coulomb_friction"), one) == 1.0


def several(t: float, q: float, v: float, u: float, z: np.ndarray) -> tuple[float, list[float]]:
    """An oscillator whose stiffness, damping and gain are all a little off."""
    return -1.1 * OMEGA**2 * q - 6.0 * q**3 - 1.8 * RATE * v + 0.9 * GAIN * u + 0.8, []


def dry(t: float, q: float, v: float, u: float, z: np.ndarray) -> tuple[float, list[float]]:
    return own(q, v, u) - 3.0 * math.tanh(v / 0.02), []


def gain_only(t: float, q: float, v: float, u: float, z: np.ndarray) -> tuple[float, list[float]]:
    return own(q, v, 0.8 * u), []


def test_a_loose_sim_beats_an_effect_where_several_parameters_are_off() -> None:
    one = contest([film(several, u=U, noise=0.005, seconds=16.0)])
    none = HypothesisFit((), one.fit((), np.zeros(one.rollout_model.nuisance.size)))
    instance = PlacedEffect(
        catalogue()["coulomb_friction"], measure_motion_scales(one.rollout_model, ALONG), direction=ALONG
    )
    start = np.concatenate([np.zeros(1), none.fit.x])
    wrong = HypothesisFit((instance,), one.fit((instance,), start))
    assert relaxed_model_log_evidence(one, ModelRanking(none, (), 2.0), wrong, nominal=1.0) > 50.0


def test_a_loose_sim_loses_against_the_one_parameter_that_is_off() -> None:
    one = contest([film(gain_only, u=U, noise=0.005, seconds=16.0)])
    none = HypothesisFit((), one.fit((), np.zeros(one.rollout_model.nuisance.size)))
    gain = PlacedEffect(
        catalogue()["input_gain"],
        measure_largest_motion_scales(one.rollout_model),
        channel=0,
        input_name="u0",
    )
    right = HypothesisFit((gain,), one.fit((gain,), np.concatenate([np.zeros(1), none.fit.x])))
    assert relaxed_model_log_evidence(one, ModelRanking(none, (), 2.0), right, nominal=1.0) < 0.0


def test_a_loose_sim_that_explains_less_is_no_rival() -> None:
    one = contest([film(dry, u=U, noise=0.005, seconds=12.0)])
    none = HypothesisFit((), one.fit((), np.zeros(one.rollout_model.nuisance.size)))
    instance = PlacedEffect(
        catalogue()["coulomb_friction"], measure_motion_scales(one.rollout_model, ALONG), direction=ALONG
    )
    right = HypothesisFit((instance,), one.fit((instance,), np.concatenate([[0.1], none.fit.x])))
    assert relaxed_model_log_evidence(one, ModelRanking(none, (), 2.0), right, nominal=1.0) == -np.inf


def test_two_shapes_that_fit_anything_are_doubted_and_one_is_not() -> None:
    one = contest([film(dry, u=U, noise=0.005, seconds=6.0)])
    rows = ModelRanking(HypothesisFit((), one.fit((), np.zeros(one.rollout_model.nuisance.size))), (), 2.0)
    alone = explained(one, "hidden_mode")
    alone = replace(alone, fit=replace(alone.fit, misfit=0.0))
    both = replace(alone, effects=(*alone.effects, *explained(one, "creep").effects))
    assert assess_implausibility(one, rows, alone, nominal=1.0).chance < 0.1
    assert assess_implausibility(one, rows, both, nominal=1.0) == Implausibility(
        IMPLAUSIBILITY.flexible_chance, "shapeless"
    )


def test_a_sim_that_misses_its_own_recordings_is_no_rival_either() -> None:
    one = contest([film(several, u=U, noise=0.005, seconds=8.0)])
    none = HypothesisFit((), one.fit((), np.zeros(one.rollout_model.nuisance.size)))
    assert relaxed_model_log_evidence(one, ModelRanking(none, (), 2.0), none, nominal=1.0) > 50.0
    assert relaxed_model_log_evidence(one, ModelRanking(none, (), 2.0), none, nominal=50.0) == -np.inf


def test_parameters_that_are_off_together_are_not_called_an_effect() -> None:
    known = ("coulomb_friction", "creep", "hysteresis")
    config = replace(settings(), without=sorted(set(catalogue()) - set(known)), always_fitted=[])
    real = film(several, u=U, noise=0.005, seconds=16.0)
    found = diagnose(EstimatedSimulator.exact(oscillator()), [real], config).diagnosis
    assert (found.verdict, found.checks["doubt"]) == ("unknown", "loose")
