"""Held-out forecasts: what is held out, and that the gap is what its blocks say."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.diagnose.effects.base import Direction, PlacedEffect
from lagsplat.diagnose.effects.elasticity import linear_stiffness
from lagsplat.diagnose.inference.holdout import (
    count_diverged,
    cut_blocks,
    estimate_closure,
    fit_half,
    forecast_blocks,
    forecast_holdout,
    split_windows,
)
from lagsplat.diagnose.inference.placement import measure_motion_scales
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit, limit_squared_deviation
from tests.unit.diagnose.toys import OMEGA, RATE, contest, film, own, wave

PERIOD_S = 1.0
STIFFER = 1.3


def stiff(t: float, q: float, v: float, u: float, z: np.ndarray) -> tuple[float, list[float]]:
    """The whole potential thirty per cent steeper."""
    return STIFFER * own(q, 0.0, 0.0) + own(q, v, u) - own(q, 0.0, 0.0), []


@pytest.fixture(scope="module")
def made() -> tuple[EstimationProblem, HypothesisFit, HypothesisFit]:
    """A contest with noise, the sim re-anchored, and the sim with what it lacks."""
    films = [film(stiff, u=wave(i), noise=0.01, seconds=16.0 - 4.0 * i, seed=i) for i in (0, 1)]
    one = replace(contest(films), period_s=PERIOD_S)
    along = Direction("q0", np.ones(1), 1.0)
    effect = PlacedEffect(
        linear_stiffness.EFFECT, measure_motion_scales(one.rollout_model, along), direction=along
    )
    n = one.rollout_model.nuisance.size
    none = HypothesisFit((), one.fit((), np.zeros(n)))
    true = HypothesisFit((effect,), one.fit((effect,), np.concatenate([[np.log(STIFFER)], np.zeros(n)])))
    return one, none, true


def test_what_is_held_out_is_not_fitted_to(
    made: tuple[EstimationProblem, HypothesisFit, HypothesisFit],
) -> None:
    half, held = split_windows(*made[:2])
    fitted = {(f, n) for f, n in zip(half.windows.first, half.windows.length, strict=True)}
    out = {(f, n) for f, n in zip(held.first, held.length, strict=True)}
    assert not fitted & out
    assert len(fitted) + len(out) == len(made[0].windows.first)
    assert abs(len(fitted) - len(out)) <= 1
    blocks = cut_blocks(made[0], held)
    assert (blocks.length == blocks.length[0]).all()
    for start in blocks.first:
        home = held.first[(held.first <= start) & (start + blocks.length[0] <= held.first + held.length)]
        assert len(home) == 1
        clips = made[0].rollout_model.dataset.clips
        assert ((clips[:, 0] <= start) & (start + blocks.length[0] <= clips[:, 1])).sum() == 1


def test_both_halves_see_what_acts_in_two_windows_alone(
    made: tuple[EstimationProblem, HypothesisFit, HypothesisFit],
) -> None:
    one, none, _ = made
    residual = none.fit.residual.copy()
    residual[[0, 2]] *= 100.0
    half, held = split_windows(one, replace(none, fit=replace(none.fit, residual=residual)))
    rare = set(one.windows.first[[0, 2]].tolist())
    assert len(rare & set(half.windows.first.tolist())) == 1
    assert len(rare & set(held.first.tolist())) == 1


def test_the_gap_is_that_of_its_blocks(made: tuple[EstimationProblem, HypothesisFit, HypothesisFit]) -> None:
    one, none, true = made
    held = forecast_holdout(one, none, true, given=one.rollout_model.model)
    rms = one.rollout_model.dataset.q.std(axis=0)
    for kind, size in (("sim", held.gap.before), ("augmented", held.gap.after)):
        squares = [np.mean(((getattr(b, kind) - b.real) / rms) ** 2) for b in held.blocks]
        assert size == pytest.approx(np.sqrt(np.mean(squares)), rel=1e-12)
    assert {b.file for b in held.blocks} == {"film 0", "film 1"}
    assert held.gap.blocks == len(held.blocks)
    assert held.gap.diverged == {"before": 0, "refit": 0, "after": 0}
    assert [b.index for b in held.blocks] == list(range(len(held.blocks)))
    assert all(np.array_equal(b.time_s, np.sort(b.time_s)) for b in held.blocks)


def test_the_true_effect_closes_the_gap_down_to_the_floor(
    made: tuple[EstimationProblem, HypothesisFit, HypothesisFit],
) -> None:
    gap = forecast_holdout(*made, given=made[0].rollout_model.model).gap
    assert gap.before > 5.0 * gap.floor
    assert gap.after == pytest.approx(gap.floor, rel=0.25)
    assert gap.after <= gap.refit < gap.before
    assert gap.closure.value == pytest.approx(1.0, abs=0.03)
    assert gap.closure.low <= gap.closure.value <= gap.closure.high


def test_a_forecast_looks_at_ten_samples_only(
    made: tuple[EstimationProblem, HypothesisFit, HypothesisFit],
) -> None:
    one, none, _ = made
    blocks = cut_blocks(one, split_windows(one, none)[1])
    told = forecast_blocks(one, blocks, (), fit_half(split_windows(one, none)[0], none))
    record = one.rollout_model.dataset
    changed = record.q.copy()
    for start, length in zip(blocks.first, blocks.length, strict=True):
        changed[start + 10 : start + length - 1] += 7.0
    other = replace(one, rollout_model=replace(one.rollout_model, dataset=replace(record, q=changed)))
    again = forecast_blocks(other, blocks, (), fit_half(split_windows(one, none)[0], none))
    assert np.abs(again.y - told.y).max() < 1e-6


def test_the_floor_is_the_error_that_the_true_model_makes(
    made: tuple[EstimationProblem, HypothesisFit, HypothesisFit],
) -> None:
    one, none, true = made
    blocks = cut_blocks(one, split_windows(one, none)[1])
    told = forecast_blocks(one, blocks, true.effects, true.fit.x)
    errors = (told.y - blocks.take(one.rollout_model.dataset.q)) ** 2
    assert errors.mean() == pytest.approx(told.expected.mean(), rel=0.35)


def test_the_sim_moves_no_further_than_is_plausible(
    made: tuple[EstimationProblem, HypothesisFit, HypothesisFit],
) -> None:
    """Its own stiffness could be thirty per cent larger, if nobody asked how likely that is."""
    one, none, true = made
    half, deviation = split_windows(one, none)[0], one.rollout_model.nuisance.deviation
    free = half.fit((), none.fit.x).x
    bounded = fit_half(half, none)
    limit = limit_squared_deviation(len(deviation))
    assert ((free / deviation) ** 2).sum() > 3.0 * limit
    assert ((bounded / deviation) ** 2).sum() == pytest.approx(limit)
    believed = half.fit(true.effects, true.fit.x).x
    assert fit_half(half, true).tolist() == believed.tolist()


def test_a_block_longer_than_what_is_held_out_is_refused(
    made: tuple[EstimationProblem, HypothesisFit, HypothesisFit],
) -> None:
    with pytest.raises(ValueError, match="record longer"):
        cut_blocks(replace(made[0], period_s=50.0), split_windows(*made[:2])[1])


def test_closure_is_one_at_the_floor_zero_where_nothing_changed_and_nothing_without_a_gap() -> None:
    rng = np.random.default_rng(0)
    before, floor = rng.uniform(0.5, 1.5, 20), rng.uniform(0.005, 0.015, 20)
    assert estimate_closure(before, floor, floor).value == pytest.approx(1.0)
    assert estimate_closure(before, before, floor).value == 0.0
    assert estimate_closure(before, 4.0 * before, floor).value < -0.9
    half = estimate_closure(
        before, (0.5 * (np.sqrt(before.mean()) + np.sqrt(floor.mean()))) ** 2 * np.ones(20), floor
    )
    assert half.value == pytest.approx(0.5, abs=1e-9)
    assert half.low < 0.5 < half.high
    noisy = floor * rng.uniform(0.8, 1.2, 20)
    assert estimate_closure(noisy, floor, floor).value is None
    assert estimate_closure(0.5 * floor, floor, floor).value is None


def test_a_forecast_that_leaves_or_is_no_number_is_counted() -> None:
    error = np.zeros((4, 30, 2))
    error[1, -1, 0] = 11.0 * 0.3
    error[2, 5, 1] = np.nan
    error[3, :, 1] = 9.0 * 2.0
    assert count_diverged(error, np.array([0.3, 2.0])) == 2


def test_constants_of_the_toy_are_those_of_the_sim() -> None:
    model = contest([film(u=wave(), seconds=8.0)]).rollout_model.model
    q, v, u = np.array([[0.4]]), np.array([[-0.7]]), np.array([[0.2]])
    assert model.acceleration(q, v, u)[0, 0] == pytest.approx(own(0.4, -0.7, 0.2))
    assert model.stiffness[0, 0] == pytest.approx(OMEGA**2, rel=1e-6)
    assert model.damping_at(q)[0, 0, 0] == RATE
