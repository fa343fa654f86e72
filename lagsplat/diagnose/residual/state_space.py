"""The most likely path and latent force of a mechanism, for steps that are linear.

Linear steps, the prior of the force and the measurement noise make a linear Gaussian state-space model
(`kalman_kernels` defines its state). Here it is built in scaled units, its variances are fitted by largest
marginal likelihood, and its path is smoothed.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from scipy.optimize import minimize
from scipy.stats import median_abs_deviation

from lagsplat.diagnose.residual.kalman_kernels import filter_forward, smooth_backward
from lagsplat.diagnose.residual.linearization import LinearSteps

FORCE_BOUNDS = (1e-10, 1e4)
"""Range of a force's variance, over the square of the acceleration that swings the motion."""
NOISE_BOUNDS = (1e-14, 1.0)  # range of the measurement noise's variance, over the motion's
START_POSITION_VARIANCE = 1.0  # variance of position at a clip's start, over the motion's
START_VELOCITY_VARIANCE = 25.0
"""Variance of velocity at a clip's start, over the square of the motion's size over ``unit_s``."""
MAX_OPTIMIZER_STEPS = 40  # steps of L-BFGS over the logarithms of the variances
FOURTH_DIFFERENCE_GAIN = 70.0
"""Variance of a fourth difference of white noise, over the noise's: 1 + 16 + 36 + 16 + 1."""


@dataclass(frozen=True)
class SmootherData:
    """Measured positions of all clips, one after the other.

    ``y`` (T, d) positions; ``starts`` (T,) True where a clip begins; ``h`` (T,) the step to the next sample
    [s], zero at a clip's end. ``scale`` (d,) is the motion's size and ``unit_s`` its period over 2 pi [s]:
    they make every variance a number near one. ``ar1`` in [0, 1) is the correlation of the measurement noise
    over a median step.
    """

    y: np.ndarray
    starts: np.ndarray
    h: np.ndarray
    scale: np.ndarray
    unit_s: float
    ar1: float

    @property
    def d(self) -> int:
        """Number of coordinates."""
        return self.y.shape[1]

    @property
    def force_scale(self) -> Float64[np.ndarray, " d"]:
        """Acceleration of a swing of the motion's size and period, (d,)."""
        return self.scale / self.unit_s**2


@dataclass(frozen=True)
class ForceVariances:
    """Length scale and variances of the latent forces and of the measurement noise.

    ``length_s`` is the forces' length scale [s]; ``values`` (2d,) the variances of the forces, then of the
    noise, each over the square of its `SmootherData` scale; ``log_likelihood`` what they reach [nats].
    """

    length_s: float
    values: np.ndarray
    log_likelihood: float = -np.inf


@dataclass(frozen=True)
class SmoothedPath:
    """Smoothed ``q``, ``v``, latent ``force`` and its ``rate`` (T, d), with the force's ``covariance``
    (T, d, d).

    The force is an acceleration: it is divided by the inertia at rest.
    """

    q: np.ndarray
    v: np.ndarray
    force: np.ndarray
    rate: np.ndarray
    covariance: np.ndarray
    variances: ForceVariances

    def force_in_step(self, h: Float64[np.ndarray, " T"]) -> Float64[np.ndarray, "T 3 d"]:
        """Expected force at the start, middle and end of each step of length ``h``."""
        weights = [
            compute_matern_weights(np.sqrt(3.0) / self.variances.length_s, part * h)
            for part in (0.0, 0.5, 1.0)
        ]
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
    noise = (
        median_abs_deviation(fourth, axis=0, scale="normal") ** 2 / FOURTH_DIFFERENCE_GAIN / record.scale**2
    )
    values = np.concatenate([np.ones(record.d), np.clip(noise, 100 * NOISE_BOUNDS[0], 0.01)])
    return ForceVariances(length_s, values)


def maximize_likelihood(
    record: SmootherData, steps: LinearSteps, start: ForceVariances, *, noise_known: bool = False
) -> ForceVariances:
    """Variances of largest marginal likelihood at ``start``'s length scale, by L-BFGS from its values.

    Args:
        record: the measured positions.
        steps: linear steps of the mechanism between samples.
        start: length scale and variances to start from.
        noise_known: keep the noise's variances as they are.
    """
    model = _build_model(record, steps, start.length_s)
    free = np.arange(record.d if noise_known else 2 * record.d)
    limits = np.log([FORCE_BOUNDS] * record.d + [NOISE_BOUNDS] * record.d)
    values = np.log(start.values)

    def loss(x: np.ndarray) -> tuple[float, np.ndarray]:
        values[free] = x
        variances = np.exp(values)
        filtered = model.forward(variances)
        slope = model.backward(filtered, moments=False)[2] * variances
        return -filtered[-1], -slope[free]

    optimum = minimize(
        loss,
        np.clip(values[free], *limits[free].T),
        jac=True,
        method="L-BFGS-B",
        bounds=limits[free],
        options={"maxiter": MAX_OPTIMIZER_STEPS, "ftol": 1e-7, "gtol": 1e-2},
    )
    values[free] = optimum.x
    return replace(start, values=np.exp(values), log_likelihood=-float(optimum.fun))


def compute_force_evidence(
    record: SmootherData, steps: LinearSteps, variances: ForceVariances
) -> Float64[np.ndarray, " d"]:
    """Log evidence (d,) for each coordinate's force: nats by which it makes the measurements more likely."""
    model = _build_model(record, steps, variances.length_s)
    full = model.forward(variances.values)[-1]
    without = []
    for i in range(record.d):
        values = variances.values.copy()
        values[i] = FORCE_BOUNDS[0]
        without.append(model.forward(values)[-1])
    return full - np.array(without)


def smooth_path(record: SmootherData, steps: LinearSteps, variances: ForceVariances) -> SmoothedPath:
    """Smooth the path and the latent force under given variances, whose likelihood is computed anew."""
    model = _build_model(record, steps, variances.length_s)
    filtered = model.forward(variances.values)
    mean, covariance, _ = model.backward(filtered, moments=True)
    d = record.d
    mean = mean * model.units
    pick = slice(2 * d, 3 * d)
    units = model.units[pick]
    return SmoothedPath(
        q=mean[:, :d],
        v=mean[:, d : 2 * d],
        force=mean[:, pick],
        rate=mean[:, 3 * d : 4 * d],
        covariance=covariance[:, pick, pick] * units[:, None] * units,
        variances=replace(variances, log_likelihood=filtered[-1]),
    )


@dataclass(frozen=True)
class _LinearGaussianModel:
    """Arguments of `filter_forward` and `smooth_backward`, in units of ``units`` (n,)."""

    y: np.ndarray
    starts: np.ndarray
    design: np.ndarray
    transition: np.ndarray
    offset: np.ndarray
    drive: np.ndarray
    colour: np.ndarray
    rate: float
    units: np.ndarray

    def forward(self, variances: np.ndarray) -> tuple:
        """Filter under ``variances`` (2d,)."""
        d = self.y.shape[1]
        start = np.repeat([START_POSITION_VARIANCE, START_VELOCITY_VARIANCE], d)
        return filter_forward(
            self.y,
            self.starts,
            self.design,
            self.transition,
            self.offset,
            self.drive,
            self.colour,
            variances,
            self.rate,
            start,
        )

    def backward(self, filtered: tuple, *, moments: bool) -> tuple:
        """Smooth what `forward` returned."""
        return smooth_backward(
            self.starts, self.design, self.transition, self.drive, self.colour, self.rate, filtered, moments
        )


def _build_model(record: SmootherData, steps: LinearSteps, length_s: float) -> _LinearGaussianModel:
    """The state-space model of a mechanism with Matern-3/2 forces of length scale ``length_s`` [s]."""
    d, unit = record.d, record.unit_s
    n = 5 * d if record.ar1 > 0.0 else 4 * d
    rate = np.sqrt(3.0) / length_s
    h = record.h
    eye = np.eye(d)
    transition = np.zeros((len(h), n, n))
    transition[:, : 2 * d, : 2 * d] = steps.phi
    for part, gamma in zip((0.0, 0.5, 1.0), np.moveaxis(steps.gamma, 1, 0), strict=True):
        now, slope = compute_matern_weights(rate, part * h)
        transition[:, : 2 * d, 2 * d : 3 * d] += now[:, None, None] * gamma
        transition[:, : 2 * d, 3 * d : 4 * d] += slope[:, None, None] * gamma
    decay = np.exp(-rate * h)
    force = np.array(
        [[(1.0 + rate * h) * decay, h * decay], [-(rate**2) * h * decay, (1.0 - rate * h) * decay]]
    )
    transition[:, 2 * d : 4 * d, 2 * d : 4 * d] = np.einsum("abt,ij->taibj", force, eye).reshape(
        -1, 2 * d, 2 * d
    )
    colour = np.zeros(len(h))
    design = np.concatenate([eye, np.zeros((d, n - d))], axis=1)
    if n == 5 * d:
        remaining = record.ar1 ** (h / np.median(h[h > 0.0]))
        transition[:, 4 * d :, 4 * d :] = remaining[:, None, None] * eye
        colour = 1.0 - remaining**2
        design[:, 4 * d :] = eye
    units = np.concatenate([record.scale / unit**power for power in (0, 1, 2, 3, 0)[: n // d]])
    scaled = force * np.array([[1.0, 1.0 / unit], [unit, 1.0]])[..., None]
    stationary = np.diag([1.0, (rate * unit) ** 2])
    drive = stationary - np.einsum("abt,bc,dct->tad", scaled, stationary, scaled)
    offset = np.zeros((len(h), n))
    offset[:, : 2 * d] = steps.offset
    return _LinearGaussianModel(
        y=np.ascontiguousarray(record.y / record.scale),
        starts=record.starts,
        design=design,
        transition=np.ascontiguousarray(transition * units / units[:, None]),
        offset=offset / units,
        drive=np.ascontiguousarray(drive),
        colour=colour,
        rate=rate * unit,
        units=units,
    )
