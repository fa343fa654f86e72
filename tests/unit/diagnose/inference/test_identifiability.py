"""What a recording tells apart, and how sharply it bounds a number, on oscillators that are known."""

import numpy as np
import pytest

from lagsplat.diagnose.core.config import PROFILES
from lagsplat.diagnose.effects.base import Direction, PlacedEffect
from lagsplat.diagnose.effects.external.external_periodic_force import limit_period
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.inference.placement import measure_largest_motion_scales, measure_motion_scales
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit
from lagsplat.diagnose.inference.profile_likelihood import (
    compute_profiles,
    compute_separability,
    estimate_parameters,
    format_parameter_unit,
)
from tests.unit.diagnose.toys import contest, film, own, wave

ALONG = Direction("q0", np.ones(1), 1.0, 0.0)
TEMPER = 2.0


def stiff(t: float, q: float, v: float, u: float, z: np.ndarray) -> tuple[float, list[float]]:
    return own(q, v, u) - 3.0 * q - 0.2 * v, []


def fitted(one: EstimationProblem, name: str) -> HypothesisFit:
    effect = catalogue()[name]
    if effect.along == "channels":
        instance = PlacedEffect(
            effect, measure_largest_motion_scales(one.rollout_model), channel=0, input_name="u0"
        )
    else:
        instance = PlacedEffect(effect, measure_motion_scales(one.rollout_model, ALONG), direction=ALONG)
    start = [p.prior.mean for p in effect.parameters]
    begun = np.concatenate([start, np.zeros(one.rollout_model.nuisance.size)])
    return HypothesisFit((instance,), one.fit((instance,), begun))


@pytest.fixture(scope="module")
def driven() -> EstimationProblem:
    return contest([film(stiff, u=wave(3), noise=0.005, seconds=16.0)])


def test_stiffness_and_damping_are_told_apart_and_each_not_from_itself(driven: EstimationProblem) -> None:
    fits = [fitted(driven, name) for name in ("linear_stiffness", "viscous_damping")]
    told = compute_separability(driven, fits, noise_inflation=TEMPER)
    assert told is not None
    assert told.names == ("linear_stiffness", "viscous_damping")
    assert np.diag(told.nats) == pytest.approx(0.0, abs=0.5)
    assert min(told.nats[0, 1], told.nats[1, 0]) > 10.0


def test_mass_and_stiffness_of_a_free_motion_are_not_told_apart() -> None:
    free = contest([film(stiff, noise=0.01, seconds=12.0)])
    told = compute_separability(
        free, [fitted(free, name) for name in ("linear_stiffness", "mass_change")], noise_inflation=TEMPER
    )
    assert told is not None
    assert told.nats[0, 1] < 3.0


def test_one_effect_alone_has_nothing_to_be_told_from(driven: EstimationProblem) -> None:
    assert compute_separability(driven, [fitted(driven, "linear_stiffness")], noise_inflation=TEMPER) is None


def test_a_profile_peaks_at_the_fit_and_falls_by_its_interval(driven: EstimationProblem) -> None:
    one = fitted(driven, "linear_stiffness")
    (profile,) = compute_profiles(driven, one, noise_inflation=TEMPER)
    assert (profile.effect, profile.parameter) == ("linear_stiffness", "ratio")
    assert len(profile.values) == 2 * PROFILES.points_per_side + 1
    assert (np.diff(profile.values) > 0.0).all()
    best = int(np.argmax(profile.log_likelihood))
    assert best == PROFILES.points_per_side
    told = estimate_parameters(driven, one, one.effects[0], TEMPER)["ratio"]
    assert profile.values[best] == pytest.approx(told.value)
    # a normal likelihood loses half of the square of the standard deviations walked
    assert profile.log_likelihood[0] == pytest.approx(-0.5 * 3.5**2, rel=0.3)
    assert profile.log_likelihood[-1] == pytest.approx(-0.5 * 3.5**2, rel=0.3)


def test_a_size_made_of_two_parameters_is_within_its_interval(driven: EstimationProblem) -> None:
    one = fitted(driven, "cogging")
    told = estimate_parameters(driven, one, one.effects[0], TEMPER)
    assert all(each.low <= each.value <= each.high for each in told.values())
    assert told["pitch"].unit == "q0"
    assert told["pitch"].low < told["pitch"].value < told["pitch"].high


def test_a_periodic_force_shows_a_whole_period() -> None:
    short = contest([film(seconds=8.0)])
    along = measure_motion_scales(short.rollout_model, ALONG)
    effect = limit_period(catalogue()["external_periodic_force"], along)
    slowest = {p.name: p.prior for p in effect.parameters}["angular_frequency"]
    period_s = 2.0 * np.pi / (slowest.value(slowest.lowest) * along.of("rate"))
    assert period_s == pytest.approx(along.duration_s)


@pytest.mark.parametrize(
    ("name", "variant", "key", "expected"),
    [
        ("external_periodic_force", "", "frequency_hz", "Hz"),
        ("external_periodic_force", "", "acceleration", "q0/s^2"),
        ("parameter_drift", "", "rate", "1/s"),
        ("parameter_drift", "load", "rate", "q0/s^3"),
    ],
)
def test_every_number_has_its_unit(
    driven: EstimationProblem, name: str, variant: str, key: str, expected: str
) -> None:
    one = PlacedEffect(
        catalogue()[name], measure_motion_scales(driven.rollout_model, ALONG), variant, direction=ALONG
    )
    assert format_parameter_unit(one, key) == expected


def test_numbers_that_no_single_unknown_makes_have_no_profile(driven: EstimationProblem) -> None:
    told = {
        one.parameter
        for one in compute_profiles(driven, fitted(driven, "stribeck_friction"), noise_inflation=TEMPER)
    }
    assert told <= {"coulomb", "velocity", "presliding"}
