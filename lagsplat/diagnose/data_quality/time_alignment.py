"""How well a linear law explains a driven motion when its inputs are taken to act earlier or later."""

from collections.abc import Sequence

import numpy as np

from lagsplat.diagnose.core.result import Finding
from lagsplat.io.trajectory.trajectory import Trajectory

MAX_SHIFT_PERIODS = 3.0  # natural periods that inputs are shifted by, at most
SHIFTS_PER_PERIOD = 16  # shifts a period
PLAUSIBLE_DELAY_PERIODS = 0.5  # of a period: what no delay of a mechanism or a line is
POOR_SHARE, MIN_SHARE_GAIN = (
    0.6,
    0.35,
)  # share explained below which the given times are doubted; a gain that settles it
MIN_PERIODS = 6.0  # of a recording, for less than which chance fits some shift
FAIR_SHARE, MIN_ERROR_SHRINKAGE = 0.85, 4.0  # the same where what is not explained shrinks by so many times


def score_input_shifts(motion: Trajectory, *, period_s: float) -> tuple[np.ndarray, np.ndarray]:
    """Shifts of the inputs [s], and the share of the motion's forced part that each explains, from 0 to 1.

    For each shift ``a = -K q - C v + B u(t - shift) + c`` is fitted in the weak form, with test functions of
    one period; the share is that of the residual without inputs that these remove. Clips shorter than two
    periods have no say. Without any the arrays are empty.
    """
    shifts = (
        period_s
        / SHIFTS_PER_PERIOD
        * np.arange(
            -round(MAX_SHIFT_PERIODS * SHIFTS_PER_PERIOD), round(MAX_SHIFT_PERIODS * SHIFTS_PER_PERIOD) + 1
        )
    )
    left, drive, right = [], [], []
    half_s = 0.5 * period_s
    s = np.linspace(-1.0, 1.0, 33)
    tests = np.stack(
        [
            (1 - s**2) ** 4,
            -8 * s * (1 - s**2) ** 3 / half_s,
            (56 * s**2 - 8) * (1 - s**2) ** 2 / half_s**2,
        ]
    )
    for start, stop in motion.segments:
        time = motion.time_s[start:stop]
        middles = np.arange(time[0] + half_s, time[-1] - half_s, period_s / 8.0)
        if time[-1] - time[0] < 2.0 * period_s or not len(middles):
            continue
        grid = middles[:, None] + half_s * s
        q = np.stack([np.interp(grid, time, column) for column in motion.q[start:stop].T], axis=-1)
        value, slope, bend = (np.einsum("k,nkd->nd", test, q) for test in tests)
        left.append(np.hstack([value, slope, np.ones((len(middles), 1))]))
        right.append(bend)
        drive.append(
            np.stack(
                [
                    np.stack(
                        [
                            np.interp(grid - shift, time, column) @ tests[0]
                            for column in motion.u[start:stop].T
                        ],
                        1,
                    )
                    for shift in shifts
                ]
            )
        )
    if not left:
        return np.zeros(0), np.zeros(0)
    own, target = np.concatenate(left), np.concatenate(right)
    inputs = np.concatenate(drive, axis=1)
    basis = np.linalg.qr(own / np.maximum(np.linalg.norm(own, axis=0), 1e-300))[0]
    rest = target - basis @ (basis.T @ target)
    size = np.maximum((rest**2).sum(axis=0), 1e-300)
    shares = []
    for column in inputs:
        free = column - basis @ (basis.T @ column)
        fitted = free @ np.linalg.lstsq(free, rest, rcond=1e-9)[0]
        shares.append(float(((fitted**2).sum(axis=0) / size).mean()))
    return shifts, np.array(shares)


def check_time_offset(motions: Sequence[Trajectory], *, period_s: float | None) -> list[Finding]:
    """Whether inputs and coordinates seem to come from clocks that differ by more than half a period."""
    found: list[Finding] = []
    for motion in motions:
        if period_s is None or not motion.n_u or not np.ptp(motion.u, axis=0).any():
            continue
        if motion.duration_s < MIN_PERIODS * period_s:
            continue
        shifts, shares = score_input_shifts(motion, period_s=period_s)
        if not len(shifts):
            continue
        near = np.abs(shifts) <= PLAUSIBLE_DELAY_PERIODS * period_s
        best = int(np.argmax(shares))
        usual = float(shares[near].max())
        better = usual < POOR_SHARE and shares[best] > usual + MIN_SHARE_GAIN
        better |= usual < FAIR_SHARE and 1.0 - usual > MIN_ERROR_SHRINKAGE * (1.0 - shares[best])
        if not near[best] and better:
            found.append(
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
    return found
