"""Slopes by the variational equations against differences of rollouts."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.diagnose.estimation.dataset import Dataset, WindowSet, cut_windows
from lagsplat.diagnose.estimation.multiple_shooting import ShootingData, differentiate_predictions
from lagsplat.diagnose.estimation.rollout import ParameterSensitivity
from lagsplat.diagnose.mechanics.basis import differentiate_basis
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.mechanics.structure import (
    ModelStructure,
    list_field_sizes,
    list_free_directions,
    pad_model,
)
from tests.oracle.test_runge_kutta import wild
from tests.unit.diagnose.toys import coupled, oscillator

STEP = 1e-5


def whole(model: MechanicalModel) -> ModelStructure:
    """Every field may depend on the coordinates, and every kind of loss is there."""
    ends = list_field_sizes(model.basis)
    return ModelStructure(ends[2], ends[1], ends[-1], ends[1] if model.n_u else 0, dry=True, drag=True)


def trial(
    model: MechanicalModel, *, dense: bool = False, held: bool = False
) -> tuple[ParameterSensitivity, np.ndarray, ShootingData]:
    """Rollouts over windows of unequal length, their starts, and data that they do not fit."""
    rng, n, d = np.random.default_rng(0), 61, model.d
    time = np.cumsum(rng.uniform(0.01, 0.03, n))
    q, v = rng.normal(0.0, 0.4, (n, d)), rng.normal(0.0, 1.0, (n, d))
    record = Dataset(
        time,
        q,
        v,
        rng.normal(size=(n, model.n_u)),
        np.array([[0, n]]),
        ("made",),
        np.zeros(1, np.int64),
        (0.0,),
        q,
    )
    windows = cut_windows(record, length_s=0.35, min_frames=12)
    form = whole(model)
    model = pad_model(model, form)
    moves = list_free_directions(model, form, np.ones(d))
    if dense:
        moves = rng.normal(size=(7, len(moves))) @ moves / np.sqrt(len(moves))
    data = ShootingData(
        windows.take(q), windows.mask()[..., None] / rng.uniform(0.5, 2.0, d), np.full(2 * d, STEP)
    )
    moving = ParameterSensitivity(model, record, windows, moves, 2, held)
    return moving, np.concatenate([q, v], axis=1)[windows.first], data


def by_differences(
    moving: ParameterSensitivity, x: np.ndarray, starts: np.ndarray, data: ShootingData
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Central differences of the rollouts."""
    ends = [
        differentiate_predictions(
            moving, x, starts, replace(data, start_step=sign * data.start_step), np.full(len(x), step)
        )
        for sign, step in ((1.0, STEP), (-1.0, -STEP))
    ]
    return ends[0][0], 0.5 * (ends[0][1] + ends[1][1]), 0.5 * (ends[0][2] + ends[1][2])


def farthest(a: np.ndarray, b: np.ndarray) -> float:
    """Largest error of any column, in units of the column's largest value."""
    return float((np.abs(a - b).max((0, 1)) / np.maximum(np.abs(b).max((0, 1)), 1e-6)).max())


MODELS = {
    "coupled": coupled(),
    "one coordinate": oscillator(),
    "one coordinate left alone": oscillator(n_u=0),
    "wild": wild(2, 1),
    "wild and left alone": wild(2, 0),
    "four coordinates": wild(4, 2),
}


@pytest.mark.parametrize("dense", [False, True])
@pytest.mark.parametrize("name", MODELS)
def test_slopes_are_the_derivatives_of_the_rollouts(name: str, dense: bool) -> None:
    moving, starts, data = trial(MODELS[name], dense=dense, held=dense)
    x = np.random.default_rng(1).normal(0.0, 0.02, len(moving.moves))
    told, right = moving.derivatives(x, starts, data), by_differences(moving, x, starts, data)
    assert np.abs(told[0] - right[0]).max() < 1e-9 * np.abs(right[0]).max()
    assert np.abs(right[1]).max() > 1e-2  # else nothing would have moved
    assert farthest(told[1], right[1]) < 1e-5
    assert farthest(told[2], right[2]) < 1e-5


def test_what_moves_alike_shares_a_column_and_what_does_not_move_has_none() -> None:
    model = coupled()
    form = ModelStructure(1, 1, 3, 1)
    moves = list_free_directions(model, form, np.ones(2))
    column_of, by_column = replace(trial(model)[0], model=model, moves=moves).columns
    # two entries of the mass, one fixed by the trace; three of the damping, two of the potential, four inputs
    assert by_column.shape == (len(moves), 3 + 3 + 2 + 4)
    mass, damping, potential, input_map, dry, drag = column_of
    assert damping[0, 1, 0] == damping[1, 0, 0]
    assert mass[0, 0, 0] != mass[1, 1, 0]
    assert potential[0] == -1
    assert (potential[1:3] >= 0).all()
    assert (mass[..., 1:] == -1).all()
    assert (input_map[..., 0] >= 0).all()
    assert (dry == -1).all()
    assert (drag == -1).all()


def test_nothing_moves_where_there_is_nothing_to_move() -> None:
    moving, starts, data = trial(coupled())
    still = replace(moving, moves=moving.moves[:0])
    residual, slopes, begun = still.derivatives(np.zeros(0), starts, data)
    whole = moving.derivatives(np.zeros(len(moving.moves)), starts, data)
    assert slopes.shape == (len(starts), residual[0].size, 0)
    assert begun == pytest.approx(whole[2], abs=1e-12)


def test_a_rollout_that_leaves_for_good_is_moved_by_nothing_from_there_on() -> None:
    moving, starts, data = trial(coupled())
    wound = replace(moving, model=replace(moving.model, damping=-400.0 * moving.model.damping))
    x = np.zeros(len(moving.moves))
    residual, slopes, begun = wound.derivatives(x, starts, data)
    assert all(np.isfinite(part).all() for part in (residual, slopes, begun))
    assert residual == pytest.approx((data.y - wound(x[None], starts[None])[0]) * data.weight)
    last = moving.windows.length - 1
    rows = [slopes.reshape(*residual.shape, -1)[w, n] for w, n in enumerate(last)]
    assert max(np.abs(row).max() for row in rows) == 0.0
    assert np.abs(slopes).max() > 0.0


def test_windows_that_end_early_have_no_slopes_beyond() -> None:
    moving, starts, data = trial(oscillator())
    short = replace(
        moving, windows=WindowSet(moving.windows.first, moving.windows.length - np.arange(len(starts)))
    )
    _, slopes, _ = short.derivatives(np.zeros(len(moving.moves)), starts, data)
    for w, n in enumerate(short.windows.length):
        assert np.abs(slopes[w, n:]).sum() == 0.0


@pytest.mark.parametrize("d", [1, 2, 4])
def test_second_derivatives_of_the_basis_are_those_of_its_slopes(d: int) -> None:
    basis = wild(d, 0).basis
    q, h = np.random.default_rng(2).normal(0.0, 0.6, d), 1e-6
    slope, second = np.empty((d, basis.size)), np.empty((d, d, basis.size))
    differentiate_basis(basis.arrays, basis.values(q[None])[0], slope, second)
    for i in range(d):
        ends = basis.slopes(np.stack([q - h * np.eye(d)[i], q + h * np.eye(d)[i]]))
        quotient = (ends[1] - ends[0]) / (2.0 * h)
        assert pytest.approx(quotient, rel=1e-5, abs=1e-7) == second[i].T
