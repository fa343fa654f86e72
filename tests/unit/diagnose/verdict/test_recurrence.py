"""How clearly a recording shows that an outer force comes from outside."""

import math
from dataclasses import replace

import numpy as np

from lagsplat.diagnose.effects.base import Direction, PlacedEffect
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.inference.placement import measure_motion_scales
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit
from lagsplat.diagnose.verdict.alternatives import measure_recurrence
from tests.unit.diagnose.toys import contest, film

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
