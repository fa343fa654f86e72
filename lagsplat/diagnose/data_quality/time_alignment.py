"""Whether inputs and coordinates share a clock: how well the motion is explained by shifted inputs."""

from collections.abc import Sequence

import numpy as np

from lagsplat.diagnose.core.config import TIME_ALIGNMENT
from lagsplat.diagnose.core.result import Finding
from lagsplat.diagnose.data_quality.natural_period import compute_test_functions
from lagsplat.io.trajectory.trajectory import Trajectory


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
    return shifts, _explain_beyond_state(np.concatenate(input_columns, axis=1), state, target)


def _explain_beyond_state(inputs: np.ndarray, state: np.ndarray, target: np.ndarray) -> np.ndarray:
    """Share of what ``state`` (n, k) leaves of ``target`` (n, d) that each of ``inputs`` (S, n, m) adds."""
    basis = np.linalg.qr(state / np.maximum(np.linalg.norm(state, axis=0), 1e-300))[0]
    rest = target - basis @ (basis.T @ target)
    size = np.maximum((rest**2).sum(axis=0), 1e-300)
    shares = []
    for columns in inputs:
        free = columns - basis @ (basis.T @ columns)
        fitted = free @ np.linalg.lstsq(free, rest, rcond=1e-9)[0]
        shares.append(float(((fitted**2).sum(axis=0) / size).mean()))
    return np.array(shares)


def check_time_offset(motions: Sequence[Trajectory], *, period_s: float | None) -> list[Finding]:
    """Report clocks of inputs and coordinates that differ by more than half a period."""
    findings: list[Finding] = []
    for motion in motions:
        if period_s is None or not motion.n_u or not np.ptp(motion.u, axis=0).any():
            continue
        if motion.duration_s < TIME_ALIGNMENT.min_periods * period_s:
            continue
        shifts, shares = score_input_shifts(motion, period_s=period_s)
        if not len(shifts):
            continue
        near = np.abs(shifts) <= TIME_ALIGNMENT.gross_shift_periods * period_s
        best = int(np.argmax(shares))
        usual = float(shares[near].max())
        better = (
            usual < TIME_ALIGNMENT.poor_explained_share
            and shares[best] > usual + TIME_ALIGNMENT.min_share_gain
        )
        better |= (
            usual < TIME_ALIGNMENT.fair_explained_share
            and 1.0 - usual > TIME_ALIGNMENT.min_error_ratio * (1.0 - shares[best])
        )
        if not near[best] and better:
            findings.append(
                Finding(
                    "undetermined",
                    "time offset",
                    motion.source,
                    f"the inputs explain the motion only if they act {shifts[best]:+.3g} s later "
                    f"({100 * shares[best]:.2g} % of it, against {100 * usual:.2g} % at the times given)",
                    "no mechanism waits that long: the clocks of inputs and coordinates differ",
                    "align the two logs, on an event that both show, and run again",
                )
            )
    return findings
