"""All checks of the data before anything is fitted: both sides prepared for use, with their findings."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np

from lagsplat.diagnose.core.config import COMPATIBILITY
from lagsplat.diagnose.core.result import Finding, refuse
from lagsplat.diagnose.data_quality.compatibility import check_coordinates, check_inputs, check_region
from lagsplat.diagnose.data_quality.discontinuities import cut_gaps, cut_jumps, drop_holds
from lagsplat.diagnose.data_quality.input_checks import check_feedback, check_time_offset
from lagsplat.diagnose.data_quality.natural_period import estimate_natural_period_s
from lagsplat.diagnose.data_quality.noise import MeasurementNoise, measure_noise
from lagsplat.diagnose.data_quality.periodic_inputs import check_periodic_inputs
from lagsplat.diagnose.data_quality.sampling import check_length, check_samples, check_slowness
from lagsplat.io.trajectory.trajectory import Trajectory

FULL_TURNS = (2.0 * np.pi, 360.0)  # a whole turn in radians and in degrees


@dataclass(frozen=True)
class PreparedSide:
    """The motions of one side, unwrapped and cut where they must not be continued, with all findings."""

    motions: tuple[Trajectory, ...]
    findings: tuple[Finding, ...]
    period_s: float | None  # natural period [s], None where nothing swings
    noise: MeasurementNoise


@dataclass(frozen=True)
class DataCheck:
    """Both sides, ready for use."""

    sim: PreparedSide | None  # None where the simulator is a model without recordings
    real: PreparedSide
    findings: tuple[Finding, ...]

    @property
    def undetermined(self) -> tuple[str, ...]:
        """Texts of the findings that make any verdict a guess; empty where the data allow one."""
        return tuple(finding.text for finding in self.findings if finding.level == "undetermined")

    @property
    def warnings(self) -> tuple[str, ...]:
        """Texts of all warnings, those that forbid a verdict first."""
        return self.undetermined + tuple(finding.text for finding in self.findings if finding.level == "warn")


def check_data(sim: Sequence[Trajectory], real: Sequence[Trajectory]) -> DataCheck:
    """Check both sides and prepare their motions.

    ``sim`` is empty where the simulator is a model without recordings.

    Raises:
        ValueError: no real motion, or sides that cannot be compared: other coordinates, or a missing input.
    """
    if not real:
        raise ValueError("real: no motion at all; name at least one recording with real=FILE")
    coordinate_findings = check_coordinates(sim, real)
    refuse(coordinate_findings)
    nominal = prepare_side(sim) if sim else None
    measured = prepare_side(real, nominal_period_s=nominal.period_s if nominal else None)
    findings = [*coordinate_findings, *check_region(nominal.motions if nominal else (), measured.motions)]
    if nominal:
        findings += check_length(nominal.motions, period_s=nominal.period_s, noise=nominal.noise, side="sim")
        findings += nominal.findings
    # An effect may have slowed the real motion: count its length in the shorter of both periods.
    periods_s = [side.period_s for side in (nominal, measured) if side and side.period_s]
    shorter_s = min(periods_s) if measured.period_s else None
    findings += check_length(measured.motions, period_s=shorter_s, noise=measured.noise, side="real")
    findings += measured.findings
    findings += check_inputs(nominal.motions if nominal else (), measured.motions)
    findings += check_periodic_inputs(measured.motions)
    known_s = nominal.period_s if nominal and nominal.period_s else measured.period_s
    findings += check_slowness(measured.motions, period_s=known_s)
    findings += check_time_offset(measured.motions, period_s=known_s)
    findings += check_feedback(measured.motions, period_s=measured.period_s)
    return DataCheck(nominal, measured, tuple(dict.fromkeys(findings)))


def prepare_side(motions: Sequence[Trajectory], *, nominal_period_s: float | None = None) -> PreparedSide:
    """Unwrap and cut the motions of one side, and measure their natural period and noise.

    ``nominal_period_s`` replaces the measured period of a driven motion where the two differ by more than
    `COMPATIBILITY.period_ratio_warning` times: then inputs and coordinates do not belong together, or
    there is too little data.
    """
    findings: list[Finding] = []

    def apply(step: tuple[Trajectory, tuple[Finding, ...]]) -> Trajectory:
        findings.extend(step[1])
        return step[0]

    ready = [apply(unwrap_angles(motion)) for motion in motions]
    period_s = estimate_natural_period_s(ready)
    ready = [apply(cut_gaps(motion, period_s=period_s)) for motion in ready]
    sigma = measure_noise(ready, period_s=period_s).known_sigma
    ready = [apply(cut_jumps(motion, sigma=sigma, period_s=period_s)) for motion in ready]
    ready = [apply(drop_holds(motion, sigma=sigma, period_s=period_s)) for motion in ready]
    period_s = estimate_natural_period_s(ready)
    driven = any(np.ptp(motion.u, axis=0).any() for motion in ready)
    if nominal_period_s is not None and driven:
        ratio, limit = (period_s or np.inf) / nominal_period_s, COMPATIBILITY.period_ratio_warning
        if not 1.0 / limit < ratio < limit:
            period_s = nominal_period_s
    noise = measure_noise(ready, period_s=period_s)
    for motion in ready:
        findings += check_samples(motion, period_s=period_s, noise=noise)
    return PreparedSide(tuple(ready), tuple(findings), period_s, noise)


def unwrap_angles(motion: Trajectory) -> tuple[Trajectory, tuple[Finding, ...]]:
    """Continue angles where a sensor wraps around from one end of a turn to the other.

    A step counts that is longer than half a turn, in radians or degrees, of an angle that keeps within one
    turn. Less the turn it must agree with the steps before and after, to within a quarter of a turn, at each
    of these steps: a cut would not. Measured rates are not touched.
    """
    q, findings = motion.q.copy(), []
    inside = motion.joined
    for i, name in enumerate(motion.q_names):
        for turn in FULL_TURNS:
            continued = np.concatenate([np.unwrap(q[a:b, i], period=turn) for a, b in motion.segments])
            wraps = inside & (np.abs(np.diff(q[:, i])) > 0.5 * turn)
            bends = np.abs(np.diff(continued, 2)) * (inside[:-1] & inside[1:])
            beside = wraps[:-1] | wraps[1:]
            if not wraps.any() or np.ptp(q[:, i]) > 1.1 * turn or (bends[beside] > 0.25 * turn).any():
                continue
            q[:, i] = continued
            what = f"{name} steps by a whole turn ({turn:.4g}) {wraps.sum()} time(s)"
            why = "an angle that starts again is no motion"
            remedy = "it is continued here; record it unwrapped if that is wrong"
            findings.append(Finding("warn", "wrapped", motion.source, what, why, remedy, (name,)))
            break
    return replace(motion, q=q), tuple(findings)
