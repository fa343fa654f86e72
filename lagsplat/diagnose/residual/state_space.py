"""The most likely path and latent force of a mechanism whose steps are linear.

Linear steps, the prior of the force and the measurement noise make a linear Gaussian state-space model, in
scaled units. Its state (4d,) is position, velocity, latent force and the force's rate, (d,) each.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64, Int64
from scipy.optimize import minimize
from scipy.stats import median_abs_deviation

from lagsplat.diagnose.residual.kalman_kernels import filter_forward, smooth_backward
from lagsplat.diagnose.residual.linearization import LinearSteps

FORCE_BOUNDS = (1e-10, 1e4)  # range of a force's variance, over the squared acceleration of the swing
NOISE_BOUNDS = (1e-14, 1.0)  # range of the measurement noise's variance, over the motion's
START_POSITION_VARIANCE = 1.0  # variance of position at a clip's start, over the motion's
START_VELOCITY_VARIANCE = 25.0  # variance of velocity at a clip's start, over (motion's size / unit_s)^2
MAX_OPTIMIZER_STEPS = 40  # steps of L-BFGS over the logarithms of the variances
IN_STEP = np.array([0.0, 0.5, 1.0])  # start, middle and end of a step
FOURTH_DIFFERENCE_GAIN = 70.0  # variance of a fourth difference of white noise, 1 + 16 + 36 + 16 + 1


@dataclass(frozen=True)
class SmootherData:
    """Measured positions of all clips, one after the other, with the units that bring variances near one."""

    y: Float64[np.ndarray, "T d"]  # positions
    starts: Bool[np.ndarray, " T"]  # where a clip begins
    h: Float64[np.ndarray, " T"]  # step to the next sample [s], zero at a clip's end
    scale: Float64[np.ndarray, " d"]  # size of the motion
    unit_s: float  # period of the motion over 2 pi [s]

    @property
    def d(self) -> int:
        """Number of coordinates."""
        return self.y.shape[1]

    @property
    def ahead(self) -> Int64[np.ndarray, " T"]:
        """The next sample of each sample's clip; at its end the sample itself."""
        return np.arange(len(self.h)) + (self.h > 0.0)


@dataclass(frozen=True)
class ForceVariances:
    """Length scale and variances of the latent forces and of the measurement noise."""

    length_s: float  # length scale of the forces [s]
    values: Float64[np.ndarray, " 2d"]  # of the forces, then of the noise, in squared units of `SmootherData`
    log_likelihood: float = -np.inf  # that they reach [nats]


@dataclass(frozen=True)
class SmoothedPath:
    """A smoothed path with its latent force, an acceleration: it is divided by the inertia at rest."""

    q: Float64[np.ndarray, "T d"]
    v: Float64[np.ndarray, "T d"]
    force: Float64[np.ndarray, "T d"]
    rate: Float64[np.ndarray, "T d"]  # of the force
    covariance: Float64[np.ndarray, "T d d"]  # of the force
    variances: ForceVariances

    def force_in_step(self, h: Float64[np.ndarray, " T"]) -> Float64[np.ndarray, "T 3 d"]:
        """Expected force at the start, middle and end of each step of length ``h``."""
        weights = _compute_matern_transition(np.sqrt(3.0) / self.variances.length_s, h[:, None] * IN_STEP)
        return np.einsum("tja,atd->tjd", weights[:, :, 0], np.stack([self.force, self.rate]))


def guess_variances(record: SmootherData, length_s: float) -> ForceVariances:
    """Variances to start from: noise by fourth differences, forces large enough to swing the motion."""
    cuts = np.flatnonzero(record.starts)[1:]
    fourth = np.concatenate([np.diff(clip, n=4, axis=0) for clip in np.split(record.y, cuts)])
    spread = median_abs_deviation(fourth, axis=0, scale="normal")
    noise = spread**2 / FOURTH_DIFFERENCE_GAIN / record.scale**2
    values = np.concatenate([np.ones(record.d), np.clip(noise, 100 * NOISE_BOUNDS[0], 0.01)])
    return ForceVariances(length_s, values)


def maximize_likelihood(record: SmootherData, steps: LinearSteps, start: ForceVariances) -> ForceVariances:
    """Variances of largest marginal likelihood at ``start``'s length scale, by L-BFGS from its values."""
    model = _build_model(record, steps, start.length_s)
    limits = np.log([FORCE_BOUNDS] * record.d + [NOISE_BOUNDS] * record.d)

    def loss(log_variances: np.ndarray) -> tuple[float, np.ndarray]:
        variances = np.exp(log_variances)
        filtered = model.filter(variances)
        return -compute_log_likelihood(filtered), -model.differentiate(filtered) * variances

    first = np.clip(np.log(start.values), *limits.T)
    options = {"maxiter": MAX_OPTIMIZER_STEPS, "ftol": 1e-7, "gtol": 1e-2}
    optimum = minimize(loss, first, jac=True, method="L-BFGS-B", bounds=limits, options=options)
    return replace(start, values=np.exp(optimum.x), log_likelihood=-float(optimum.fun))


def compute_force_evidence(
    record: SmootherData, steps: LinearSteps, variances: ForceVariances
) -> Float64[np.ndarray, " d"]:
    """Log evidence for each coordinate's force: nats by which it makes the measurements more likely."""
    model, d = _build_model(record, steps, variances.length_s), record.d
    trials = np.tile(variances.values, (d + 1, 1))
    trials[np.arange(d), np.arange(d)] = FORCE_BOUNDS[0]
    *without, full = (compute_log_likelihood(model.filter(values)) for values in trials)
    return full - np.array(without)


def smooth_path(record: SmootherData, steps: LinearSteps, variances: ForceVariances) -> SmoothedPath:
    """Smooth the path and the latent force under given variances."""
    model, d = _build_model(record, steps, variances.length_s), record.d
    mean, covariance, *filtered = model.filter(variances.values)
    r, information, _ = smooth_backward(model.transition, *filtered)
    smooth = (mean + covariance @ r)[..., 0] * model.units
    q, v, force, rate = np.split(smooth, 4, axis=1)
    seen = covariance[:, 2 * d : 3 * d]  # of the force with the whole state
    force_covariance = seen[:, :, 2 * d : 3 * d] - seen @ information @ seen.mT
    units = model.units[2 * d : 3 * d]
    return SmoothedPath(q, v, force, rate, force_covariance * units[:, None] * units, variances)


def compute_log_likelihood(filtered: tuple) -> float:
    """Log-likelihood [nats] of the observations, from what `filter_forward` returned."""
    _, _, innovation, inverse, _ = filtered
    quadratic = (innovation.mT @ inverse @ innovation).sum()
    determinant = np.linalg.slogdet(inverse).logabsdet.sum()
    return 0.5 * float(determinant - quadratic - innovation.size * np.log(2.0 * np.pi))


@dataclass(frozen=True)
class _LinearGaussianModel:
    """What `kalman_kernels` takes, with positions, velocities, forces and their rates in ``units``."""

    y: Float64[np.ndarray, "T d"]
    transition: Float64[np.ndarray, "T 4d 4d"]
    offset: Float64[np.ndarray, "T 4d"]
    start: Float64[np.ndarray, "T 2d 2d"]  # covariance of position and velocity at a clip's start, else zero
    drive: Float64[np.ndarray, "T 2 2"]  # covariance that a force of variance one and its rate receive
    units: Float64[np.ndarray, " 4d"]

    def filter(self, variances: Float64[np.ndarray, " 2d"]) -> tuple:
        """Filter under variances of forces and measurement noise; see `filter_forward`."""
        d = self.y.shape[1]
        process = np.zeros_like(self.transition)
        process[:, : 2 * d, : 2 * d] = self.start
        process[:, 2 * d :, 2 * d :] = np.kron(self.drive, np.diag(variances[:d]))
        columns = self.y[..., None], self.transition, self.offset[..., None]
        return filter_forward(*columns, process, variances[d:])

    def differentiate(self, filtered: tuple) -> Float64[np.ndarray, " 2d"]:
        """Derivatives of the log-likelihood by the variances, from what `filter` returned."""
        d = self.y.shape[1]
        r, information, noise = smooth_backward(self.transition, *filtered[2:])
        r = r[:, 2 * d :].reshape(-1, 2, d)
        weight = information[:, 2 * d :, 2 * d :].reshape(-1, 2, d, 2, d)
        excess = np.einsum("tai,tbi->tabi", r, r) - np.einsum("taibi->tabi", weight)
        return np.concatenate([0.5 * np.einsum("tab,tabi->i", self.drive, excess), noise])


def _build_model(record: SmootherData, steps: LinearSteps, length_s: float) -> _LinearGaussianModel:
    """The state-space model of a mechanism with Matern-3/2 forces of length scale ``length_s`` [s]."""
    d, unit, starts = record.d, record.unit_s, record.starts
    rate = np.sqrt(3.0) / length_s
    forces = _compute_matern_transition(rate, record.h[:, None] * IN_STEP)
    transition = np.zeros((len(starts), 4 * d, 4 * d))
    transition[:, : 2 * d, : 2 * d] = steps.phi
    acting = np.einsum("tjb,tjxi->txbi", forces[:, :, 0], steps.gamma)
    transition[:, : 2 * d, 2 * d :] = acting.reshape(-1, 2 * d, 2 * d)
    transition[:, 2 * d :, 2 * d :] = np.kron(forces[:, 2], np.eye(d))
    units = np.concatenate([record.scale / unit**power for power in range(4)])
    y = record.y / record.scale
    offset = np.concatenate([steps.offset, np.zeros((len(starts), 2 * d))], axis=1) / units
    scaled = _compute_matern_transition(rate * unit, record.h / unit)
    stationary = np.diag([1.0, (rate * unit) ** 2])
    drive = stationary - scaled @ stationary @ scaled.mT
    # from here on, steps lead to a sample instead of from it, and a clip begins with a step from nothing
    transition, offset, drive = (np.roll(values, 1, axis=0) for values in (transition, offset, drive))
    transition[starts], drive[starts] = 0.0, stationary
    offset[starts] = np.pad(y[starts], ((0, 0), (0, 3 * d)))
    start = starts[:, None, None] * np.diag(np.repeat([START_POSITION_VARIANCE, START_VELOCITY_VARIANCE], d))
    return _LinearGaussianModel(y, transition * units / units[:, None], offset, start, drive, units)


def _compute_matern_transition(rate: float, h: Float64[np.ndarray, "*n"]) -> Float64[np.ndarray, "*n 2 2"]:
    """What value and derivative of a Matern-3/2 process are expected to be after ``h`` [s], from those now.

    ``rate`` [1/s] is the root of three over the length scale.
    """
    part = rate * h
    rows = [[1.0 + part, h], [-rate * part, 1.0 - part]]
    return np.moveaxis(np.exp(-part) * np.array(rows), (0, 1), (-2, -1))
