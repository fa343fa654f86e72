"""Whether the inputs were chosen freely, or by a controller that answered the motion."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from scipy.stats import f as f_law

from lagsplat.diagnose.core.config import CLOSED_LOOP
from lagsplat.diagnose.core.result import Finding
from lagsplat.diagnose.data_quality.noise import fit_locally
from lagsplat.io.trajectory.trajectory import Trajectory


@dataclass(frozen=True)
class Feedback:
    """Signs of a controller in one input; NaN where the data cannot show them.

    ``error_share`` is the share of the input's noise that earlier measurement noise explains,
    ``static_share`` the share of the input that is a function of position and rate.
    """

    error_share: float
    static_share: float


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
    shares, weights = [], []
    for start, stop in motion.segments:
        if stop - start < 60:
            continue
        signal, errors = motion.u[start:stop, channel], motion.q[start:stop]
        fine = np.diff(signal, CLOSED_LOOP.difference_order)
        # Steps of an input are no noise: differences across one are left out.
        change = np.abs(np.diff(signal))
        step = (
            np.convolve(
                change > CLOSED_LOOP.step_ratio * np.median(change),
                np.ones(CLOSED_LOOP.difference_order),
                mode="valid",
            )
            > 0.5
        )
        rows = np.arange(CLOSED_LOOP.max_controller_lag, len(fine) - CLOSED_LOOP.max_controller_lag)
        rows = rows[~step[rows]]
        if len(rows) < 60 or not (_is_rough(signal) and any(_is_rough(column) for column in errors.T)):
            continue
        rough = np.diff(errors, CLOSED_LOOP.difference_order, axis=0)
        past = np.hstack([rough[rows - lag] for lag in range(CLOSED_LOOP.max_controller_lag + 1)])
        ahead = np.hstack([rough[rows + lag] for lag in range(1, CLOSED_LOOP.max_controller_lag + 1)])
        shares.append(_compute_partial_share(past, fine[rows], given=ahead))
        weights.append(len(rows))
    return float(np.average(shares, weights=weights)) if shares else np.nan


def _is_rough(values: np.ndarray) -> bool:
    """Whether high differences of a column contain noise rather than a remainder of its motion."""
    fine, finer = (
        np.abs(np.diff(values, CLOSED_LOOP.difference_order - 1)),
        np.abs(np.diff(values, CLOSED_LOOP.difference_order)),
    )
    floor = 1e-11 * np.abs(values).max()
    return bool(
        np.median(finer) > floor
        and np.median(finer) ** 2 > CLOSED_LOOP.min_power_growth * np.median(fine) ** 2
    )


def _compute_partial_share(columns: np.ndarray, target: np.ndarray, *, given: np.ndarray) -> float:
    """Share of ``target`` that ``columns`` explain beyond ``given``; zero where chance explains as much."""
    base = np.linalg.qr(given / np.maximum(np.linalg.norm(given, axis=0), 1e-300))[0]
    rest, free = target - base @ (base.T @ target), columns - base @ (base.T @ columns)
    size = float(rest @ rest)
    if size <= 0.0 or np.linalg.norm(free) == 0.0:
        return 0.0
    fitted = free @ np.linalg.lstsq(free, rest, rcond=1e-9)[0]
    share = min(float(fitted @ fitted) / size, 1.0 - 1e-12)
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
    half = int(np.clip(0.08 * period_s / motion.dt_s, 2, 40))
    fit = fit_locally(motion, half_width=half)
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
            passes_noise = trace.error_share > CLOSED_LOOP.min_explained_share
            if not passes_noise and not trace.static_share > CLOSED_LOOP.min_static_share:
                continue
            evidence = (
                f"{100 * trace.error_share:.2g} % of its errors repeat earlier errors of the coordinates"
                if passes_noise
                else f"{100 * trace.static_share:.3g} % of it is a function of position and rate"
            )
            findings.append(
                Finding(
                    "warn",
                    "closed_loop",
                    motion.source,
                    f"{name} answers the motion: {evidence}",
                    "in a closed loop delays and gains of the input come out biased",
                    "drive it open loop, or with a reference of its own added, to tell input effects apart",
                    (name,),
                )
            )
    return findings
