"""Angles that a sensor starts again from the other end of a turn.

Everything that can be known of the data before anything is fitted.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lagsplat.diagnose.core.config import TRAJECTORY_CHECKS
from lagsplat.diagnose.core.result import Finding, refuse
from lagsplat.diagnose.data_quality.closed_loop import check_feedback
from lagsplat.diagnose.data_quality.compatibility import check_coordinates, check_region
from lagsplat.diagnose.data_quality.discontinuities import cut_gaps, cut_jumps, drop_holds
from lagsplat.diagnose.data_quality.excitation_measures import check_inputs
from lagsplat.diagnose.data_quality.natural_period import estimate_natural_period_s
from lagsplat.diagnose.data_quality.noise import MeasurementNoise, measure_noise
from lagsplat.diagnose.data_quality.sampling import check_length, check_samples, count_blocks
from lagsplat.diagnose.data_quality.time_alignment import check_time_offset
from lagsplat.io.trajectory.trajectory import Trajectory

FULL_TURNS = (2.0 * np.pi, 360.0)
"""A full turn [rad, deg]."""


def unwrap_angles(motion: Trajectory) -> tuple[Trajectory, tuple[Finding, ...]]:
    """The motion with angles continued where a sensor starts again from the other end of a turn.

    A step of a whole turn, in radians or degrees, to within a quarter of it counts, where no other step is a
    tenth as long; rates are not touched.
    """
    q, found = motion.q.copy(), []
    inside = motion.joined
    for i in range(motion.d):
        step = np.diff(q[:, i])
        for turn in FULL_TURNS:
            jumps = np.flatnonzero(inside & (np.abs(np.abs(step) - turn) < 0.25 * turn))
            others = np.delete(np.abs(step), jumps)
            span = np.ptp(q[:, i])
            if not jumps.size or span > 1.1 * turn or (others[np.delete(inside, jumps)] > 0.1 * turn).any():
                continue
            shift = np.zeros(motion.n)
            for start, stop in motion.segments:
                own = jumps[(jumps >= start) & (jumps < stop - 1)]
                for at in own:
                    shift[at + 1 : stop] -= turn * np.sign(step[at])
            q[:, i] += shift
            found.append(
                Finding(
                    "warn",
                    "wrapped",
                    motion.source,
                    f"{motion.q_names[i]} steps by a whole turn ({turn:.4g}) {len(jumps)} time(s)",
                    "an angle that starts again is no motion",
                    "it is continued here; record it unwrapped if that is wrong",
                    (motion.q_names[i],),
                )
            )
            break
    return replace(motion, q=q), tuple(found)


@dataclass(frozen=True)
class PreparedSide:
    """The motions of one side, unwrapped and cut where they are not continued, with what was found.

    ``period_s`` is the natural period [s], None where nothing swings; ``blocks`` counts what can be divided
    into fit and test.
    """

    motions: tuple[Trajectory, ...]
    findings: tuple[Finding, ...]
    period_s: float | None
    noise: MeasurementNoise
    blocks: int


@dataclass(frozen=True)
class DataCheck:
    """Both sides as they are to be used; ``sim`` is None where the sim is no motion but a model."""

    sim: PreparedSide | None
    real: PreparedSide
    findings: tuple[Finding, ...]

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Why any name would be a guess; empty where the data allow a verdict."""
        return tuple(finding.text for finding in self.findings if finding.level == "undetermined")

    @property
    def warnings(self) -> tuple[str, ...]:
        """What to keep in mind, those that forbid a verdict first."""
        return self.undetermined + tuple(found.text for found in self.findings if found.level == "warn")

    @property
    def closed_loop(self) -> tuple[str, ...]:
        """Inputs of the real side that answer the motion."""
        found = [finding.columns for finding in self.findings if finding.check == "closed_loop"]
        return tuple(sorted({name for columns in found for name in columns}))


def check_data(sim: Sequence[Trajectory], real: Sequence[Trajectory]) -> DataCheck:
    """Both sides checked; ``sim`` is empty where the sim is a model without motions of its own.

    Raises:
        ValueError: no real motion, or sides that cannot be compared: other coordinates, or a missing input.
    """
    if not real:
        raise ValueError("real: no motion at all; name at least one recording with real=FILE")
    agreed = check_coordinates(sim, real)
    refuse(agreed)
    nominal = prepare_side(sim) if sim else None
    seen = prepare_side(real, nominal_period_s=nominal.period_s if nominal else None)
    found = [*agreed]
    if nominal:
        found += check_region(nominal.motions, seen.motions)
        found += check_length(nominal.motions, period_s=nominal.period_s, noise=nominal.noise, side="sim")
        found += nominal.findings
    # What is sought may have slowed the real thing down, or left too little of it to tell.
    periods_s = [side.period_s for side in (nominal, seen) if side and side.period_s]
    shorter_s = min(periods_s) if seen.period_s else None
    found += check_length(seen.motions, period_s=shorter_s, noise=seen.noise, side="real")
    found += seen.findings
    found += check_inputs(nominal.motions if nominal else (), seen.motions)
    known_s = nominal.period_s if nominal and nominal.period_s else seen.period_s
    found += check_time_offset(seen.motions, period_s=known_s)
    found += check_feedback(seen.motions, period_s=seen.period_s)
    return DataCheck(nominal, seen, tuple(_drop_duplicates(found)))


def prepare_side(motions: Sequence[Trajectory], *, nominal_period_s: float | None = None) -> PreparedSide:
    """One side unwrapped and cut, with its natural period, its noise and what was found on the way.

    ``nominal_period_s`` stands in for the own period of a driven motion where the two differ by more than
    `TRAJECTORY_CHECKS.period_ratio_warning` times: then inputs and coordinates do not belong together, or too
    little of them is there.
    """
    found: list[Finding] = []

    def apply(step: tuple[Trajectory, tuple[Finding, ...]]) -> Trajectory:
        found.extend(step[1])
        return step[0]

    ready = [apply(unwrap_angles(motion)) for motion in motions]
    period_s = estimate_natural_period_s(ready)
    ready = [apply(cut_gaps(motion, period_s=period_s)) for motion in ready]
    sigma = measure_noise(ready, period_s=period_s).sigma
    ready = [apply(cut_jumps(motion, sigma=sigma, period_s=period_s)) for motion in ready]
    ready = [apply(drop_holds(motion, sigma=sigma, period_s=period_s)) for motion in ready]
    period_s = estimate_natural_period_s(ready)
    if nominal_period_s is not None and any(
        motion.n_u and np.ptp(motion.u, axis=0).any() for motion in ready
    ):
        ratio = (period_s or np.inf) / nominal_period_s
        period_s = (
            period_s
            if 1.0 / TRAJECTORY_CHECKS.period_ratio_warning < ratio < TRAJECTORY_CHECKS.period_ratio_warning
            else nominal_period_s
        )
    noise = measure_noise(ready, period_s=period_s)
    for motion in ready:
        found += check_samples(motion, period_s=period_s, noise=noise)
    blocks = count_blocks(ready, period_s=period_s) if period_s is not None else 0
    return PreparedSide(tuple(ready), tuple(found), period_s, noise, blocks)


def _drop_duplicates(findings: Sequence[Finding]) -> list[Finding]:
    return list(dict.fromkeys(findings))
