"""The most likely path and latent force of a mechanism whose steps are linear.

Linear steps, the prior of the force and the measurement noise make a linear Gaussian state-space model, in
scaled units; `kalman_kernels` defines its state.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Bool, Float64
from scipy.optimize import minimize
from scipy.stats import median_abs_deviation

from lagsplat.diagnose.residual.kalman_kernels import filter_forward, smooth_backward
from lagsplat.diagnose.residual.linearization import LinearSteps

FORCE_BOUNDS = (1e-10, 1e4)  # range of a force's variance, over the squared acceleration of the swing
NOISE_BOUNDS = (1e-14, 1.0)  # range of the measurement noise's variance, over the motion's
START_POSITION_VARIANCE = 1.0  # variance of position at a clip's start, over the motion's
START_VELOCITY_VARIANCE = 25.0  # variance of velocity at a clip's start, over (motion's size / unit_s)^2
MAX_OPTIMIZER_STEPS = 40  # steps of L-BFGS over the logarithms of the variances
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
        decay = np.sqrt(3.0) / self.variances.length_s
        weights = [compute_matern_weights(decay, part * h) for part in (0.0, 0.5, 1.0)]
        return np.stack([a[:, None] * self.force + b[:, None] * self.rate for a, b in weights], axis=1)


def compute_matern_weights(rate: float, h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights of a Matern-3/2 process's value and derivative now in its expected value ``h`` later.

    ``rate`` [1/s] is the root of three over the length scale; ``h`` (T,) [s].
    """
    decay = np.exp(-rate * h)
    return (1.0 + rate * h) * decay, h * decay


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
        filtered = model.forward(variances)
        slope = model.backward(filtered, moments=False)[2] * variances
        return -filtered[-1], -slope

    first = np.clip(np.log(start.values), *limits.T)
    options = {"maxiter": MAX_OPTIMIZER_STEPS, "ftol": 1e-7, "gtol": 1e-2}
    optimum = minimize(loss, first, jac=True, method="L-BFGS-B", bounds=limits, options=options)
    return replace(start, values=np.exp(optimum.x), log_likelihood=-float(optimum.fun))


def compute_force_evidence(
    record: SmootherData, steps: LinearSteps, variances: ForceVariances
) -> Float64[np.ndarray, " d"]:
    """Log evidence for each coordinate's force: nats by which it makes the measurements more likely."""
    model = _build_model(record, steps, variances.length_s)
    full = model.forward(variances.values)[-1]
    without = []
    for i in range(record.d):
        values = variances.values.copy()
        values[i] = FORCE_BOUNDS[0]
        without.append(model.forward(values)[-1])
    return full - np.array(without)


def smooth_path(record: SmootherData, steps: LinearSteps, variances: ForceVariances) -> SmoothedPath:
    """Smooth the path and the latent force under given variances."""
    model = _build_model(record, steps, variances.length_s)
    filtered = model.forward(variances.values)
    mean, covariance, _ = model.backward(filtered, moments=True)
    q, v, force, rate = np.split(mean * model.units, 4, axis=1)
    pick = slice(2 * record.d, 3 * record.d)
    units = model.units[pick]
    covariance = covariance[:, pick, pick] * units[:, None] * units
    return SmoothedPath(q, v, force, rate, covariance, variances)


@dataclass(frozen=True)
class _LinearGaussianModel:
    """Arguments of `filter_forward` and `smooth_backward`, in units of ``units`` (n,)."""

    y: np.ndarray
    starts: np.ndarray
    transition: np.ndarray
    offset: np.ndarray
    drive: np.ndarray
    rate: float
    units: np.ndarray

    def forward(self, variances: np.ndarray) -> tuple:
        """Filter under ``variances`` (2d,)."""
        start = np.repeat([START_POSITION_VARIANCE, START_VELOCITY_VARIANCE], self.y.shape[1])
        steps = (self.transition, self.offset, self.drive)
        return filter_forward(self.y, self.starts, *steps, variances, self.rate, start)

    def backward(self, filtered: tuple, *, moments: bool) -> tuple:
        """Smooth what `forward` returned."""
        return smooth_backward(self.starts, self.transition, self.drive, self.rate, filtered, moments)


def _build_model(record: SmootherData, steps: LinearSteps, length_s: float) -> _LinearGaussianModel:
    """The state-space model of a mechanism with Matern-3/2 forces of length scale ``length_s`` [s]."""
    d, unit = record.d, record.unit_s
    rate = np.sqrt(3.0) / length_s
    h = record.h
    transition = np.zeros((len(h), 4 * d, 4 * d))
    transition[:, : 2 * d, : 2 * d] = steps.phi
    for part, gamma in zip((0.0, 0.5, 1.0), np.moveaxis(steps.gamma, 1, 0), strict=True):
        now, slope = compute_matern_weights(rate, part * h)
        transition[:, : 2 * d, 2 * d : 3 * d] += now[:, None, None] * gamma
        transition[:, : 2 * d, 3 * d :] += slope[:, None, None] * gamma
    decay = np.exp(-rate * h)
    change = [-(rate**2) * h * decay, (1.0 - rate * h) * decay]
    force = np.array([compute_matern_weights(rate, h), change])
    transition[:, 2 * d :, 2 * d :] = np.einsum("abt,ij->taibj", force, np.eye(d)).reshape(-1, 2 * d, 2 * d)
    units = np.concatenate([record.scale / unit**power for power in range(4)])
    scaled = force * np.array([[1.0, 1.0 / unit], [unit, 1.0]])[..., None]
    stationary = np.diag([1.0, (rate * unit) ** 2])
    drive = stationary - np.einsum("abt,bc,dct->tad", scaled, stationary, scaled)
    offset = np.concatenate([steps.offset, np.zeros((len(h), 2 * d))], axis=1)
    return _LinearGaussianModel(
        y=np.ascontiguousarray(record.y / record.scale),
        starts=record.starts,
        transition=np.ascontiguousarray(transition * units / units[:, None]),
        offset=offset / units,
        drive=np.ascontiguousarray(drive),
        rate=rate * unit,
        units=units,
    )
