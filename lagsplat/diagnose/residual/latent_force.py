"""The latent force: what a simulator lacks, over time and with its uncertainty, from measured positions.

Each coordinate is given a force with a Matern-3/2 covariance. Position, velocity, force and force rate are
estimated together by an iterated extended Kalman smoother: the mechanism is linearised along the last
estimate of the whole path, smoothed, and so on. The forces' and the noise's variances are those of largest
marginal likelihood, and so is the force's length scale among `LATENT_FORCE.length_scales_periods`. No
position is differenced.

Forces are accelerations throughout: they are divided by the inertia at rest (`MechanicalModel.rest_inertia`).
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64

from lagsplat.diagnose.core.config import LATENT_FORCE
from lagsplat.diagnose.mechanics.model import (
    MechanicalModel,
    compute_rest_frequencies_hz,
)
from lagsplat.diagnose.residual.linearization import (
    LinearSteps,
    StatePath,
    compute_kinematic_steps,
    linearize_steps,
)
from lagsplat.diagnose.residual.state_space import (
    FORCE_BOUNDS,
    ForceVariances,
    SmoothedPath,
    SmootherData,
    compute_force_evidence,
    guess_variances,
    maximize_likelihood,
    smooth_path,
)
from lagsplat.io.trajectory.trajectory import Trajectory


@dataclass(frozen=True)
class LatentForceEstimate:
    """A motion and the force that its simulator lacks.

    From ``evidence`` on, all motions that were smoothed together have the same values.
    """

    motion: Trajectory
    q: Float64[np.ndarray, "T d"]  # smoothed position
    v: Float64[np.ndarray, "T d"]  # smoothed velocity
    a: Float64[np.ndarray, "T d"]  # smoothed acceleration
    residual: Float64[np.ndarray, "T d"]  # real minus simulated force over the inertia at rest
    covariance: Float64[np.ndarray, "T d d"]  # of the residual
    innovation: Float64[np.ndarray, "T d"]  # measured minus smoothed position
    evidence: Float64[np.ndarray, " d"]  # nats by which each force makes the measurements more likely
    noise: Float64[np.ndarray, " d"]  # standard deviation of the measurement noise
    length_s: float  # length scale of the force [s]

    @property
    def std(self) -> np.ndarray:
        """Standard deviation of ``residual``, (T, d)."""
        return np.sqrt(np.maximum(np.diagonal(self.covariance, axis1=1, axis2=2), 0.0))

    @property
    def active(self) -> Bool[np.ndarray, " d"]:
        """Which coordinates have a force with enough evidence to be kept; the others' residual is zero."""
        return self.evidence >= LATENT_FORCE.min_log_likelihood_gain


def join_signals(estimates: Sequence[LatentForceEstimate], *names: str) -> Iterator[np.ndarray]:
    """The named fields of all estimates, or of their motions (``u``, ``time_s``), one after another."""
    for name in names:
        owners = [estimate.motion if name in ("u", "time_s") else estimate for estimate in estimates]
        yield np.concatenate([getattr(owner, name) for owner in owners])


def compute_rms_acceleration(smoothed: Sequence[LatentForceEstimate]) -> Float64[np.ndarray, " d"]:
    """Root mean square of each coordinate's acceleration, the unit in which its residual is measured."""
    return np.sqrt(np.mean(np.concatenate([estimate.a for estimate in smoothed]) ** 2, axis=0))


def compute_relative_squares(smoothed: Sequence[LatentForceEstimate]) -> list[Float64[np.ndarray, "T d"]]:
    """Squared residual of every sample over the mean squared acceleration; zero where no force was kept."""
    unit = compute_rms_acceleration(smoothed)
    return [np.where(estimate.active, (estimate.residual / unit) ** 2, 0.0) for estimate in smoothed]


def compute_coordinate_shares(smoothed: Sequence[LatentForceEstimate]) -> Float64[np.ndarray, " d"]:
    """Share of the squared residual in each coordinate, summing to one; zeros where there is none."""
    total = np.sum([square.sum(axis=0) for square in compute_relative_squares(smoothed)], axis=0)
    return total / total.sum() if total.sum() > 0.0 else total


def estimate_latent_force(
    mechanics: MechanicalModel,
    motions: Sequence[Trajectory],
    *,
    period_s: float,
    hold: str = "linear",
) -> list[LatentForceEstimate]:
    """Estimate the path and the latent force of all ``motions`` under one set of variances.

    Measured velocities are not used: most are filtered positions, delayed and smoothed in unknown ways.

    ``period_s`` is the natural period [s]; ``hold`` is "linear" for inputs that are linear between samples,
    "zoh" for constant ones.

    Raises:
        ValueError: another number of coordinates or inputs than the simulator has, or a coordinate that never
            moves.
        LinAlgError: the simulator's forces along the motion are not finite, or its fastest mode is far too
            fast for the sampling.

    Source: method of latent forces (Alvarez, Luengo, Lawrence 2009) by state-space smoothing (Hartikainen and
    Sarkka 2012), iterated as by Bell (1994).
    """
    for motion in motions:
        if (motion.d, motion.n_u) != (mechanics.d, mechanics.n_u):
            raise ValueError(
                f"{motion.source}: {motion.d} coordinates and {motion.n_u} inputs, but the sim has "
                f"{mechanics.d} and {mechanics.n_u}; give both sides the same columns"
            )
    record = _join_positions(motions, np.concatenate([motion.q for motion in motions]), period_s)
    u = np.concatenate([motion.u for motion in motions])
    then = u if hold == "zoh" else u[record.ahead]
    inputs = np.stack([u, 0.5 * (u + then), then], axis=1)
    fastest_s = min([period_s, *(1.0 / compute_rest_frequencies_hz(mechanics, record.scale)[-1:])])

    def linearize(at: SmoothedPath) -> LinearSteps:
        q, v, ahead = at.q, at.v, record.ahead
        middle = 0.5 * (q + q[ahead]) + 0.125 * record.h[:, None] * (v - v[ahead])
        along = StatePath(record.h, q, v, middle, q[ahead], inputs, at.force_in_step(record.h))
        return linearize_steps(mechanics, along, scale=record.scale, period_s=fastest_s)

    kinematic = compute_kinematic_steps(record.h, record.d)
    start = guess_variances(record, LATENT_FORCE.length_scales_periods[1] * period_s)
    free = maximize_likelihood(record, kinematic, start)
    path = smooth_path(record, kinematic, free)
    # All of this path's acceleration is its force, most of which the model explains from here on.
    linear = linearize(replace(path, force=0.0 * path.force, rate=0.0 * path.rate))
    first = replace(free, values=free.values * np.repeat([LATENT_FORCE.start_force_share, 1.0], record.d))
    best = maximize_likelihood(record, linear, first)
    linear = linearize(smooth_path(record, linear, best))
    best = _choose_length_scale(record, linear, best, period_s)
    gained = compute_force_evidence(record, linear, best)
    # The likeliest variance is positive in half of all recordings without a force, hence the threshold.
    silent = np.append(gained < LATENT_FORCE.min_log_likelihood_gain, np.zeros(record.d, dtype=bool))
    best = replace(best, values=np.where(silent, FORCE_BOUNDS[0], best.values))
    path = smooth_path(record, linear, best)
    for _ in range(LATENT_FORCE.max_iterations):
        previous, path = path, smooth_path(record, linearize(path), best)
        change = np.sqrt(np.mean((path.q - previous.q) ** 2, axis=0)) / record.scale
        if np.max(change) < LATENT_FORCE.path_tolerance:
            break
    response = np.linalg.solve(mechanics.mass_at(path.q), (mechanics.rest_inertia * path.force)[..., None])
    a = mechanics.acceleration(path.q, path.v, u) + response[..., 0]
    return _split_by_motion(motions, record, path, a, gained)


@dataclass(frozen=True)
class SmoothedMotion:
    """A motion without its measurement noise, by no mechanics but that accelerations are smooth."""

    q: Float64[np.ndarray, "T d"]
    v: Float64[np.ndarray, "T d"]
    a: Float64[np.ndarray, "T d"]


def smooth_motions(motions: Sequence[Trajectory], *, periods_s: Sequence[float]) -> list[SmoothedMotion]:
    """Smooth every coordinate by itself: its acceleration is a random function of Matern-3/2 covariance.

    Variances and length scale are those of largest marginal likelihood. ``periods_s`` are the periods [s]
    of the coordinates. One that never moves stays as it is.
    """
    y = np.concatenate([motion.q for motion in motions])
    columns = []
    for i, period_s in enumerate(periods_s):
        if np.ptp(y[:, i]) == 0.0:
            columns.append(y[:, i, None] * [1.0, 0.0, 0.0])
            continue
        record = _join_positions(motions, y[:, i : i + 1], period_s)
        steps = compute_kinematic_steps(record.h, 1)
        start = guess_variances(record, period_s)
        path = smooth_path(record, steps, _choose_length_scale(record, steps, start, period_s))
        columns.append(np.concatenate([path.q, path.v, path.force], axis=1))
    stacked = np.stack(columns, axis=2)  # (T, 3, d)
    ends = np.cumsum([motion.n for motion in motions])[:-1]
    return [SmoothedMotion(*np.moveaxis(part, 1, 0)) for part in np.split(stacked, ends)]


def _choose_length_scale(
    record: SmootherData, steps: LinearSteps, start: ForceVariances, period_s: float
) -> ForceVariances:
    """The likeliest variances at the likeliest length scale."""
    candidates = [
        maximize_likelihood(record, steps, replace(start, length_s=share * period_s))
        for share in LATENT_FORCE.length_scales_periods
    ]
    return max(candidates, key=lambda candidate: candidate.log_likelihood)


def _join_positions(
    motions: Sequence[Trajectory], y: Float64[np.ndarray, "T d"], period_s: float
) -> SmootherData:
    """Positions ``y`` of all motions with the scales of the state-space model.

    Raises:
        ValueError: a coordinate never moves.
    """
    time_s = np.concatenate([motion.time_s for motion in motions])
    starts = np.concatenate([np.append(True, ~motion.joined) for motion in motions])
    scale = np.std(y, axis=0)
    if not np.all(scale > 0.0):
        raise ValueError(f"coordinates {np.flatnonzero(scale == 0.0).tolist()} stand still in every motion")
    h = np.append(np.where(starts[1:], 0.0, np.diff(time_s)), 0.0)
    return SmootherData(y, starts, h, scale, period_s / (2.0 * np.pi))


def _split_by_motion(
    motions: Sequence[Trajectory], record: SmootherData, path: SmoothedPath, a: np.ndarray, gained: np.ndarray
) -> list[LatentForceEstimate]:
    """Estimates of the single motions from the path of all with its acceleration; all numbers are finite."""
    signals = path.q, path.v, a, path.force, path.covariance, record.y - path.q
    if not all(np.isfinite(values).all() for values in signals):
        raise np.linalg.LinAlgError(
            "the sim's forces along the motion are not finite; check its units and signs"
        )
    noise = np.sqrt(path.variances.values[record.d :]) * record.scale
    ends = np.cumsum([motion.n for motion in motions])[:-1]
    common = {"evidence": gained, "noise": noise, "length_s": path.variances.length_s}
    parts = zip(*(np.split(values, ends) for values in signals), strict=True)
    return [LatentForceEstimate(motion, *part, **common) for motion, part in zip(motions, parts, strict=True)]
