"""Whether inputs were chosen freely or by a controller that answered the motion, and on which clock."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import f as f_law

from lagsplat.diagnose.core.config import CLOSED_LOOP, TIME_ALIGNMENT
from lagsplat.diagnose.core.result import Finding
from lagsplat.diagnose.data_quality.natural_period import compute_test_functions
from lagsplat.diagnose.data_quality.noise import fit_over_time
from lagsplat.diagnose.data_quality.periodic_inputs import estimate_common_period_s
from lagsplat.io.trajectory.trajectory import Trajectory


@dataclass(frozen=True)
class Feedback:
    """Signs of a controller in one input; NaN where the data cannot show them."""

    error_share: float  # of the input's noise that earlier measurement noise explains
    static_share: float  # of the input that is a function of position and rate


def measure_feedback(motion: Trajectory, *, channel: int, period_s: float) -> Feedback:
    """Measure signs of a controller in input ``channel``, with the natural period ``period_s`` [s].

    A controller passes on the sensor's noise. Differences of the input, of an order that leaves only noise,
    are regressed on those of q at that sample and the `CLOSED_LOOP.max_controller_lag` before, given those
    after. The mechanism itself answers an input smoothly, so this dependence cannot come from it. Without
    noise the input is regressed on q and v, which is conclusive only where the motion is neither slow nor at
    one frequency.
    """
    if motion.n < 60:
        return Feedback(np.nan, np.nan)
    return Feedback(_compute_error_share(motion, channel), _compute_static_share(motion, channel, period_s))


def _compute_error_share(motion: Trajectory, channel: int) -> float:
    """Share of the input's noise that earlier noise of q explains, over all clips; NaN without noise."""
    order, longest = CLOSED_LOOP.difference_order, CLOSED_LOOP.max_controller_lag
    shares, weights = [], []
    for start, stop in motion.segments:
        if stop - start < 60:
            continue
        signal, errors = motion.u[start:stop, channel], motion.q[start:stop]
        fine, rough = np.diff(signal, order), np.diff(errors, order, axis=0)
        # Steps of an input are no noise: differences across one are left out.
        change = np.abs(np.diff(signal))
        steps = change > CLOSED_LOOP.step_ratio * np.median(change)
        rows = np.flatnonzero(np.convolve(steps, np.ones(order), mode="valid") <= 0.5)
        rows = rows[(rows >= longest) & (rows < len(fine) - longest)]
        if len(rows) < 60 or not (_is_rough(signal) and any(_is_rough(column) for column in errors.T)):
            continue
        past = np.hstack([rough[rows - lag] for lag in range(longest + 1)])
        ahead = np.hstack([rough[rows + lag] for lag in range(1, longest + 1)])
        shares.append(_compute_partial_share(past, fine[rows], given=ahead))
        weights.append(len(rows))
    return float(np.average(shares, weights=weights)) if shares else np.nan


def _is_rough(values: np.ndarray) -> bool:
    """Whether high differences of a column contain noise rather than a remainder of its motion."""
    order = CLOSED_LOOP.difference_order
    fine, finer = (np.median(np.abs(np.diff(values, n))) for n in (order - 1, order))
    return bool(finer > 1e-11 * np.abs(values).max() and finer**2 > CLOSED_LOOP.min_power_growth * fine**2)


def _compute_partial_share(columns: np.ndarray, target: np.ndarray, *, given: np.ndarray) -> float:
    """Share of ``target`` that ``columns`` explain beyond ``given``; zero where chance explains as much."""
    share = min(_explain_beyond(given, target[:, None], [columns])[0], 1.0 - 1e-12)
    n, p = len(target) // CLOSED_LOOP.difference_order, columns.shape[1]  # differencing correlates neighbours
    ratio = share / p / ((1.0 - share) / max(n - p, 1))
    return share if f_law.sf(ratio, p, max(n - p, 1)) < CLOSED_LOOP.max_p_value else 0.0


def _compute_static_share(motion: Trajectory, channel: int, period_s: float) -> float:
    """Share of the input that is a function of position and rate; NaN where this would be inconclusive."""
    u = motion.u[:, channel] - motion.u[:, channel].mean()
    if not u.any():
        return np.nan
    power = np.abs(np.fft.rfft(u * np.hanning(len(u)))) ** 2
    peak = int(np.argmax(power))
    if power[max(0, peak - 2) : peak + 3].sum() > CLOSED_LOOP.single_line_share * power.sum():
        return np.nan
    fit = fit_over_time(motion, width_s=min(0.16 * period_s, 80 * motion.dt_s))
    pull = (2.0 * np.pi / period_s) ** 2 * (fit.q - fit.q.mean(axis=0))
    if not (fit.a.std(axis=0) > CLOSED_LOOP.max_relative_acceleration * pull.std(axis=0)).any():
        return np.nan
    scaled = (fit.q - fit.q.mean(axis=0)) / np.maximum(fit.q.std(axis=0), 1e-300)
    rate = fit.v / np.maximum(fit.v.std(axis=0), 1e-300)
    columns = np.hstack([np.ones((motion.n, 1)), scaled, rate, scaled**2, scaled**3, np.tanh(3.0 * rate)])
    rest = u - columns @ np.linalg.lstsq(columns, u, rcond=1e-9)[0]
    return 1.0 - float(rest @ rest) / float(u @ u)


def check_feedback(motions: Sequence[Trajectory], *, period_s: float | None) -> list[Finding]:
    """Report inputs that a controller derives from the motion, which biases delays and gains."""
    findings: list[Finding] = []
    for motion in motions:
        for channel, name in enumerate(motion.u_names):
            if period_s is None or not np.ptp(motion.u[:, channel]):
                continue
            trace = measure_feedback(motion, channel=channel, period_s=period_s)
            if trace.error_share > CLOSED_LOOP.min_explained_share:
                share = 100 * trace.error_share
                evidence = f"{share:.2g} % of its errors repeat earlier errors of the coordinates"
            elif trace.static_share > CLOSED_LOOP.min_static_share:
                evidence = f"{100 * trace.static_share:.3g} % of it is a function of position and rate"
            else:
                continue
            what = f"{name} answers the motion: {evidence}"
            why = "in a closed loop delays and gains of the input come out biased"
            remedy = "drive it open loop, or with a reference of its own added, to tell input effects apart"
            findings.append(Finding("warn", "closed_loop", motion.source, what, why, remedy, (name,)))
    return findings


def score_input_shifts(motion: Trajectory, *, period_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Shifts of the inputs [s], and the share of the forced motion that each explains, from 0 to 1.

    For each shift ``a = -K q - C v + B u(t - shift) + c`` is fitted in the weak form, with test functions of
    one period; the share is the part of the residual without inputs that these remove. ``period_s`` is the
    natural period [s]. Clips shorter than two periods are left out; if none is left the arrays are empty.
    """
    most = round(TIME_ALIGNMENT.max_shift_periods * TIME_ALIGNMENT.shifts_per_period)
    shifts = period_s / TIME_ALIGNMENT.shifts_per_period * np.arange(-most, most + 1)
    state_columns, input_columns, accelerations = [], [], []
    half_s = 0.5 * period_s
    s = np.linspace(-1.0, 1.0, 33)
    tests = np.stack(compute_test_functions(s, half_s))
    for start, stop in motion.segments:
        time = motion.time_s[start:stop]
        middles = np.arange(time[0] + half_s, time[-1] - half_s, period_s / 8.0)
        if time[-1] - time[0] < 2.0 * period_s or not len(middles):
            continue
        grid = middles[:, None] + half_s * s
        q = np.stack([np.interp(grid, time, column) for column in motion.q[start:stop].T], axis=-1)
        value, slope, bend = (np.einsum("k,nkd->nd", test, q) for test in tests)
        state_columns.append(np.hstack([value, slope, np.ones((len(middles), 1))]))
        accelerations.append(bend)
        u = motion.u[start:stop]
        shifted = [[np.interp(grid - shift, time, column) @ tests[0] for column in u.T] for shift in shifts]
        input_columns.append(np.stack([np.stack(columns, 1) for columns in shifted]))
    if not state_columns:
        return np.zeros(0), np.zeros(0)
    state, target = np.concatenate(state_columns), np.concatenate(accelerations)
    return shifts, np.array(_explain_beyond(state, target, np.concatenate(input_columns, axis=1)))


def _explain_beyond(given: np.ndarray, target: np.ndarray, added: Iterable[np.ndarray]) -> list[float]:
    """Share of what ``given`` (n, k) leaves of ``target`` (n, d) that each of ``added`` (n, m) explains."""
    basis = np.linalg.qr(given / np.maximum(np.linalg.norm(given, axis=0), 1e-300))[0]
    rest, *remaining = (array - basis @ (basis.T @ array) for array in (target, *added))
    size = np.maximum((rest**2).sum(axis=0), 1e-300)
    fits = [free @ np.linalg.lstsq(free, rest, rcond=1e-9)[0] for free in remaining]
    return [float(((fitted**2).sum(axis=0) / size).mean()) for fitted in fits]


def check_time_offset(motions: Sequence[Trajectory], *, period_s: float | None) -> list[Finding]:
    """Report clocks of inputs and coordinates that differ by more than half a period."""
    findings: list[Finding] = []
    for motion in motions:
        if period_s is None or not np.ptp(motion.u, axis=0).any():
            continue
        if motion.duration_s < TIME_ALIGNMENT.min_periods * period_s:
            continue
        shifts, shares = score_input_shifts(motion, period_s=period_s)
        if not len(shifts):
            continue
        # a shift of a periodic input is the same as one within half its period
        longest_s = 0.5 * (estimate_common_period_s([motion]) or np.inf)
        shifts, shares = shifts[np.abs(shifts) <= longest_s], shares[np.abs(shifts) <= longest_s]
        near = np.abs(shifts) <= TIME_ALIGNMENT.gross_shift_periods * period_s
        best = int(np.argmax(shares))
        share, usual = shares[best], shares[near].max()
        gains = share > usual + TIME_ALIGNMENT.min_share_gain
        shrinks = 1.0 - usual > TIME_ALIGNMENT.min_error_ratio * (1.0 - share)
        better = usual < TIME_ALIGNMENT.poor_explained_share and gains
        better |= usual < TIME_ALIGNMENT.fair_explained_share and shrinks
        if not near[best] and better:
            what = (
                f"the inputs explain the motion only if they act {shifts[best]:+.3g} s later "
                f"({100 * share:.2g} % of it, against {100 * usual:.2g} % at the times given)"
            )
            why = "no mechanism waits that long: the clocks of inputs and coordinates differ"
            remedy = "align the two logs, on an event that both show, and run again"
            findings.append(Finding("undetermined", "time offset", motion.source, what, why, remedy))
    return findings
