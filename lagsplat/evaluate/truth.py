"""Compare learned physics with the truth of a simulated recording, which training never used."""

from collections.abc import Callable, Sequence
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float64
from scipy.optimize import linear_sum_assignment

from lagsplat.chart.chart import Chart
from lagsplat.evaluate.modes import fit_modes
from lagsplat.integer_lists import choose_evenly, list_powers
from lagsplat.stage2.equilibrium import (
    LinearizedModes,
    NoEquilibriumError,
    find_equilibrium,
    linearize_modes,
)
from lagsplat.stage2.fit import RARE_REST, measure_rest_distance
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.stage2.likelihood.parameter_vector import ParameterVector
from lagsplat.stage2.likelihood.uncertainty import STEP, TAILS, draw_modes, measure_intervals
from lagsplat.systems.truth import Truth

VISIBLE = 0.05  # least share of the energy of a free window with which a mode counts as excited
SAME = 0.25  # most relative distance in frequency between a fitted true oscillation and a true mode
STATES = 2000  # maximum number of states, evenly spaced, at which the inertia is measured
DEGREE = 3  # of the map from latents to true coordinates
RIDGE = 1e-9
Mode = dict[str, float]
Triple = tuple[Mode, Mode | None, Mode | None]
"""One oscillation as found in the true motion, the rollout and the encoded motion."""
RATES = (("frequency_hz", "frequency", "Hz"), ("rate_per_s", "decay rate", "1/s"))
LINEARISED, ROLLOUT = "linearised law", "free rollout"
AT_REST = "at rest"


class ComparedQuantity(NamedTuple):
    """What a row is of. A mode is numbered from 1 as in the truth, a coordinate named as there."""

    quantity: str
    unit: str | None
    source: str
    state: str | None = None
    mode: int | None = None
    coordinate: str | None = None


def compare_with_truth(
    metrics: dict[str, Any],
    truth: Truth,
    chart: Chart,
    lagrangian: Lagrangian,
    *,
    draws: Float64[np.ndarray, "n p"] | None = None,
) -> dict[str, Any]:
    """Frequency and decay of the modes, and the equilibrium, each learned and true.

    Each of ``rows`` has the fields of `ComparedQuantity`, ``learned``, ``truth``, ``error`` (relative, or for
    an equilibrium as a fraction of the motion's rms), ``low`` and ``high`` (an interval that holds the truth
    with probability 0.9, where the law has ``draws``), ``extrapolated`` (whether it is of a rest state that
    the recording hardly visits, of which intervals know nothing), ``encoded`` (the same estimator on the
    encoded motion, whose error is the chart's) and ``residual`` (of the map to coordinates, as a fraction).
    None where nothing was measured.

    Where no free window excites a mode, the slowest is compared. ``free rollout`` and the true motion are
    fitted on the same windows of free motion, because frequency depends on amplitude and the fit has a bias.
    ``linearised law``, at rest or at the mean pressure, is compared with the true eigenvalues. ``metrics`` is
    the result of `evaluate` for this run.

    Raises:
        ValueError: truth and chart are of recordings of different length.
    """
    if len(truth.states) != len(chart.latents):
        raise ValueError(
            f"the truth has {len(truth.states)} states and the chart {len(chart.latents)} latents: they are "
            "of different recordings; simulate and train again"
        )
    windows = _free_windows(metrics, truth, chart)
    oscillating = np.flatnonzero(truth.damped_frequencies_hz > 0).tolist()
    excited = sorted({number for window in windows for number in window}) or oscillating[:1]
    # without intervals, a mode that nothing excites would look as if it were known
    compared = excited if draws is None else oscillating
    rows = []
    for number in excited:
        rows += _rolled_out([window[number] for window in windows if number in window], number)
    still = np.zeros(lagrangian.n_inputs)
    spread = _draw(lagrangian, draws, still)
    true = {"frequency_hz": truth.damped_frequencies_hz, "rate_per_s": truth.decay_rates_per_s}
    at_rest = _law_rows(lagrangian, still, spread, true, compared, AT_REST)
    extrapolated = measure_rest_distance(lagrangian, chart.train) > RARE_REST
    rows += [row | {"extrapolated": extrapolated} for row in at_rest]
    if len(truth.mean_pressure):
        true = {"frequency_hz": truth.loaded_frequencies_hz, "rate_per_s": truth.loaded_decay_rates_per_s}
        held = truth.mean_pressure
        loaded = _draw(lagrangian, draws, held)
        rows += _law_rows(lagrangian, held, loaded, true, compared, "at mean pressure")
    return {"rows": rows + _equilibrium_rows(truth, chart, lagrangian, spread)}


def _draw(
    lagrangian: Lagrangian, draws: Float64[np.ndarray, "n p"] | None, u: Float64[np.ndarray, " n_u"]
) -> list[LinearizedModes]:
    """Modes of the drawn laws under an input; none where nothing was drawn."""
    if draws is None:
        return []
    return draw_modes(ParameterVector(lagrangian), draws, torch.from_numpy(u))


def _law_rows(
    lagrangian: Lagrangian,
    held: Float64[np.ndarray, " n_u"],
    spread: Sequence[LinearizedModes],
    true: dict[str, np.ndarray],
    compared: Sequence[int],
    state: str,
) -> list[dict[str, Any]]:
    """Modes of the law under a constant input beside the true eigenvalues, with intervals from drawn laws."""
    try:
        modes = linearize_modes(lagrangian, torch.from_numpy(held))
    except NoEquilibriumError:
        modes = LinearizedModes([], [], [])
    intervals = measure_intervals(modes, spread)
    turning = [
        {"frequency_hz": f, "rate_per_s": rate, "at": float(i)}
        for i, (f, rate) in enumerate(zip(modes.frequency_hz, modes.decay_per_s, strict=True))
        if f > 0
    ]
    numbers = [number for number in compared if number < len(true["frequency_hz"])]
    matched = _matched(turning, [float(true["frequency_hz"][number]) for number in numbers])
    rows = []
    for number, mode in zip(numbers, matched, strict=True):
        for i, (key, quantity, unit) in enumerate(RATES):
            of = ComparedQuantity(quantity, unit, LINEARISED, state, mode=number + 1)
            row = _row(of, None if mode is None else mode[key], float(true[key][number]))
            if mode is not None and len(intervals):
                row |= dict(zip(("low", "high"), intervals[int(mode["at"]), i].tolist(), strict=True))
            rows.append(row)
    return rows


def _free_windows(metrics: dict[str, Any], truth: Truth, chart: Chart) -> list[dict[int, Triple]]:
    """For each window of free motion, the visible true oscillations by number, with their counterparts.

    Coordinates are weighted by their motion in the recording, so that one which hardly moves counts little.
    """
    metric = np.diag(np.maximum(truth.states.std(axis=0), 1e-12) ** -2.0)
    windows = []
    for row in metrics["damping"]["windows"]:
        first = chart.n_train + row["start"]
        series = truth.states[first : first + row["frames"]]
        modes = fit_modes(series, dt_s=chart.dt_s, metric=metric, most=series.shape[1] + 1)
        true: dict[int, dict[str, float]] = {}
        for mode in _visible([mode._asdict() for mode in modes]):
            apart = np.abs(mode["frequency_hz"] / np.maximum(truth.damped_frequencies_hz, 1e-300) - 1.0)
            if apart.min() < SAME:
                true.setdefault(int(apart.argmin()), mode)
        frequencies = [mode["frequency_hz"] for mode in true.values()]
        sides = [_matched(_visible(row[f"{side}_modes"]), frequencies) for side in ("rollout", "encoded")]
        windows.append(dict(zip(true, zip(true.values(), *sides, strict=True), strict=True)))
    return windows


def _visible(modes: Sequence[Mode]) -> list[Mode]:
    return [mode for mode in modes if mode["share"] >= VISIBLE]


def _matched(modes: Sequence[Mode], frequencies_hz: Sequence[float]) -> list[Mode | None]:
    """The mode nearest to each frequency in octaves; no mode is matched twice."""
    learned = np.array([mode["frequency_hz"] for mode in modes])
    wanted = np.array(frequencies_hz)[:, None]
    rows, columns = linear_sum_assignment(np.abs(np.log(learned / wanted)))
    places = dict(zip(rows.tolist(), columns.tolist(), strict=True))
    return [modes[places[i]] if i in places else None for i in range(len(frequencies_hz))]


def _rolled_out(triples: Sequence[Triple], number: int) -> list[dict[str, Any]]:
    """Medians over windows with a visible true mode; of each estimate, over those where it has one too."""
    sides = [[mode for mode in side if mode is not None] for side in zip(*triples, strict=True)]
    rows = []
    for key, quantity, unit in RATES:
        true, learned, encoded = (
            float(np.median([mode[key] for mode in side])) if side else None for side in sides or ([], [], [])
        )
        of = ComparedQuantity(quantity, unit, ROLLOUT, mode=number + 1)
        rows.append(_row(of, learned, true, encoded))
    return rows


def _equilibrium_rows(
    truth: Truth, chart: Chart, lagrangian: Lagrangian, spread: Sequence[LinearizedModes]
) -> list[dict[str, Any]]:
    """The learned equilibrium in the true coordinates, through a map fitted on the training frames."""
    smooth = chart.whole.smoothed(chart.smoothing_frames).latents
    known, unseen = slice(None, chart.n_train), slice(chart.n_train, None)
    to_states = fit_polynomial(smooth[known], truth.states[known])
    motion = truth.states.std(axis=0)
    missed = np.sqrt(np.mean((to_states(smooth[unseen]) - truth.states[unseen]) ** 2, axis=0))
    compared = [_name_equilibrium(title) for title in truth.coordinates]
    try:
        latent = find_equilibrium(lagrangian).numpy()
    except NoEquilibriumError:
        return [_row(of, None, float(rest)) for of, rest in zip(compared, truth.rest, strict=True)]
    learned = to_states(latent[None])[0]
    errors, residuals = np.abs(learned - truth.rest) / motion, missed / motion
    rows = []
    for i, of in enumerate(compared):
        row = _row(of, float(learned[i]), float(truth.rest[i]))
        row |= {"error": float(errors[i]), "residual": float(residuals[i])}
        if spread:
            moved = to_states(np.array([modes.equilibrium for modes in spread]))[:, i] - learned[i]
            ends = learned[i] + np.quantile(moved / STEP, TAILS)
            row |= dict(zip(("low", "high"), ends.tolist(), strict=True))
        rows.append(row)
    return rows


def _name_equilibrium(coordinate: str) -> ComparedQuantity:
    """That of a coordinate, which is called by its name and its unit in brackets."""
    name, _, unit = coordinate.removesuffix("]").partition(" [")
    return ComparedQuantity("equilibrium", unit or None, "law", AT_REST, coordinate=name)


def _row(
    of: ComparedQuantity, learned: float | None, truth: float | None, encoded: float | None = None
) -> dict[str, Any]:
    error = abs(learned / truth - 1.0) if learned is not None and truth else None
    row = {**of._asdict(), "learned": learned, "truth": truth, "error": error, "encoded": encoded}
    return row | {"residual": None, "low": None, "high": None, "extrapolated": None}


def inertia_along(lagrangian: Lagrangian, states: Float64[np.ndarray, "T d"]) -> dict[str, float]:
    """The mass matrix at whitened states, as plain numbers without unit.

    ``state_dependence`` is the rms distance of the matrices from their mean over the rms of the matrices
    (Frobenius norms): 0 for a constant mass. ``span`` is the largest over the smallest eigenvalue relative
    to the mean matrix, anywhere on the trajectory: 1 for a constant mass, and the same in any chart.
    ``condition_median`` and ``condition_max`` are condition numbers in the whitened chart.

    Source: paper, "Decoder-induced inertia".
    """
    chosen = states[choose_evenly(len(states), STATES)]
    with torch.no_grad():
        matrices = lagrangian.mass(torch.from_numpy(chosen)).double().numpy()
    mean = matrices.mean(axis=0)
    apart, size = (np.sqrt(np.mean(np.sum(part**2, axis=(1, 2)))) for part in (matrices - mean, matrices))
    values = np.linalg.eigvalsh(matrices)
    half = np.linalg.inv(np.linalg.cholesky(mean))
    relative = np.linalg.eigvalsh(half @ matrices @ half.T)
    condition = values[:, -1] / values[:, 0]
    return {
        "state_dependence": float(apart / size),
        "span": float(relative.max() / relative.min()),
        "condition_median": float(np.median(condition)),
        "condition_max": float(condition.max()),
        "states": len(chosen),
    }


def fit_polynomial(
    q: Float64[np.ndarray, "T d"], states: Float64[np.ndarray, "T n"]
) -> Callable[[Float64[np.ndarray, "N d"]], Float64[np.ndarray, "N n"]]:
    """The cubic polynomial of ``q`` that fits ``states`` best, by least squares with a small ridge.

    The ridge is relative to the mean square of the monomials; it only keeps directions without motion from
    fitting rounding errors.

    Source: Hastie, Tibshirani and Friedman, The Elements of Statistical Learning, section 3.4.1.
    """
    monomials = _monomials(q)
    scale = np.maximum(np.sqrt(np.mean(monomials**2, axis=0)), 1e-12)
    scaled = monomials / scale
    moments = scaled.T @ scaled / len(q)
    weights = np.linalg.solve(moments + RIDGE * np.eye(len(scale)), scaled.T @ states / len(q))

    def predict(points: np.ndarray) -> np.ndarray:
        return (_monomials(points) / scale) @ weights

    return predict


def _monomials(q: np.ndarray) -> np.ndarray:
    d = q.shape[1]
    powers = list_powers(d, lowest=0, highest=DEGREE)
    return np.stack([np.prod(q[:, np.repeat(np.arange(d), power)], axis=1) for power in powers], axis=1)
