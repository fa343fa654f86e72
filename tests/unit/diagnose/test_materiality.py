"""When an effect matters, and when a gap is left open."""

import numpy as np
import pytest

from lagsplat.diagnose.core.config import VERDICT
from lagsplat.diagnose.core.result import Gap, Interval
from lagsplat.diagnose.diagnosis import diagnose, is_closed, is_material, is_open, is_within_tolerance
from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator
from lagsplat.diagnose.inference.holdout import HeldOutBlocks, HoldoutForecasts
from tests.unit.diagnose.toys import film, oscillator, settings, wave
from tests.unit.diagnose.verdict.made_alternatives import FIT

NOTHING = Interval(None, None, None)


def forecasts(
    share: Interval = NOTHING, given: Interval = NOTHING, refit: Interval = NOTHING
) -> HoldoutForecasts:
    gap = Gap(before=1.0, refit=0.9, after=0.5, floor=0.4, horizon_s=1.0, closure=NOTHING)
    blocks = HeldOutBlocks.__new__(HeldOutBlocks)  # none of them is forecast here
    return HoldoutForecasts(blocks, gap, (), np.ones(3), np.ones(3), share, given, refit)


@pytest.mark.parametrize(
    ("value", "low", "material"),
    [(0.3, 0.1, True), (0.3, -0.1, False), (0.04, 0.03, False), (0.05, 0.01, True)],
)
def test_an_effect_matters_if_it_closes_a_share_and_not_by_chance(value, low, material) -> None:
    assert is_material(FIT, forecasts(share=Interval(value, low, 0.5)), 0.05) is material


@pytest.mark.parametrize(("value", "low", "left"), [(2.0, 1.5, True), (2.0, 0.9, False), (1.2, 1.1, False)])
def test_a_gap_is_open_well_above_the_floor(value, low, left) -> None:
    ratio = Interval(value, low, 3.0)
    assert is_open(ratio) is left
    assert is_within_tolerance(forecasts(given=ratio, refit=Interval(1.1, 0.9, 1.2))) is left
    assert not is_within_tolerance(forecasts(given=ratio, refit=Interval(2.0, 1.5, 2.5)))


@pytest.mark.parametrize(("value", "low"), [(2.0, 0.9), (2.0, 1.5), (1.2, 1.1)])
def test_no_gap_is_both_open_and_closed(value, low) -> None:
    ratio = Interval(value, low, 3.0)
    assert is_open(ratio) + is_closed(ratio) == (low != 0.9)


def test_nothing_is_concluded_where_chance_may_have_left_the_gap_open(monkeypatch) -> None:
    sim, real = EstimatedSimulator.exact(oscillator()), [film(u=wave(4), noise=0.01, seed=4, seconds=16.0)]
    assert "undetermined" not in diagnose(sim, real, settings()).diagnosis.checks
    # what is at its floor counts as open, and its interval holds the floor
    monkeypatch.setattr(VERDICT, "open_gap", 0.5)
    (reason,) = diagnose(sim, real, settings()).diagnosis.checks["undetermined"]
    assert "chance" in reason
