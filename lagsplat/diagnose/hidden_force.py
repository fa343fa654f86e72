"""A path, its hidden force and the variances of both, for steps that are linear."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from scipy.optimize import minimize
from scipy.stats import median_abs_deviation

from lagsplat.diagnose.kernel_latent_force import backward, forward
from lagsplat.diagnose.linearise import Steps

FORCE_BOUNDS = (1e-10, 1e4)  # variance of the force, over the square of what swings the motion
NOISE_BOUNDS = (1e-14, 1.0)  # variance of the noise, over the motion's
START_POSITION, START_VELOCITY = 1.0, 25.0  # variances at a clip's start, over the motion's
STEPS = 40


@dataclass(frozen=True)
class Record:
    """Measured positions ``y`` (T, d), where clips begin ``fresh`` (T,), the step to the next sample ``h``
    (T,) [s], zero at a clip's end. ``scale`` (d,) is the motion's size and ``unit_s`` its period over 2 pi:
    they make every variance a number near one. ``ar1`` is the noise's correlation over a median step.
    """

    y: np.ndarray
    fresh: np.ndarray
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
        """Acceleration that swings the motion."""
        return self.scale / self.unit_s**2


@dataclass(frozen=True)
class Variances:
    """Length scale of the hidden force [s], and variances (2d,) of the forces, then of the noise, each over
    the square of its `Record` scale, with the log-likelihood they reach (nats)."""

    length_s: float
    values: np.ndarray
    log_likelihood: float = -np.inf


@dataclass(frozen=True)
class Estimate:
    """Smoothed ``q``, ``v``, hidden ``force``, its ``rate`` (T, d) and its ``covariance`` (T, d, d)."""

    q: np.ndarray
    v: np.ndarray
    force: np.ndarray
    rate: np.ndarray
    covariance: np.ndarray
    variances: Variances

    def force_in_step(self, h: Float64[np.ndarray, " T"]) -> Float64[np.ndarray, "T 3 d"]:
        """Expected force at the start, middle and end of each step of length ``h``."""
        weights = [
            matern_weights(np.sqrt(3.0) / self.variances.length_s, part * h) for part in (0.0, 0.5, 1.0)
        ]
        return np.stack([a[:, None] * self.force + b[:, None] * self.rate for a, b in weights], axis=1)


def matern_weights(rate: float, h: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Weights of the value and of the derivative now in the expected value ``h`` later, Matern-3/2."""
    fade = np.exp(-rate * h)
    return (1.0 + rate * h) * fade, h * fade


def first_guess(record: Record, length_s: float) -> Variances:
    """Noise from fourth differences of each clip, forces as large as what swings the motion."""
    cuts = np.flatnonzero(record.fresh)[1:]
    fourth = np.concatenate([np.diff(clip, n=4, axis=0) for clip in np.split(record.y, cuts)])
    noise = median_abs_deviation(fourth, axis=0, scale="normal") ** 2 / 70.0 / record.scale**2
    values = np.concatenate([np.ones(record.d), np.clip(noise, 100 * NOISE_BOUNDS[0], 0.01)])
    return Variances(length_s, values)


def most_likely(record: Record, steps: Steps, start: Variances, *, noise_known: bool = False) -> Variances:
    """Variances of largest marginal likelihood at ``start``'s length scale, sought from its values."""
    chain = _chain(record, steps, start.length_s)
    free = np.arange(record.d if noise_known else 2 * record.d)
    limits = np.log([FORCE_BOUNDS] * record.d + [NOISE_BOUNDS] * record.d)
    values = np.log(start.values)

    def loss(x: np.ndarray) -> tuple[float, np.ndarray]:
        values[free] = x
        variances = np.exp(values)
        filtered = chain.forward(variances)
        slope = chain.backward(filtered, moments=False)[2] * variances
        return -filtered[-1], -slope[free]

    found = minimize(
        loss, np.clip(values[free], *limits[free].T), jac=True, method="L-BFGS-B", bounds=limits[free],
        options={"maxiter": STEPS, "ftol": 1e-7, "gtol": 1e-2},
    )  # fmt: skip
    values[free] = found.x
    return replace(start, values=np.exp(values), log_likelihood=-float(found.fun))


def evidence(record: Record, steps: Steps, variances: Variances) -> Float64[np.ndarray, " d"]:
    """Nats by which each coordinate's force makes the record more likely than without it."""
    chain = _chain(record, steps, variances.length_s)
    full = chain.forward(variances.values)[-1]
    without = []
    for i in range(record.d):
        values = variances.values.copy()
        values[i] = FORCE_BOUNDS[0]
        without.append(chain.forward(values)[-1])
    return full - np.array(without)


def estimate(record: Record, steps: Steps, variances: Variances) -> Estimate:
    """Smoothed path and force under given variances; their likelihood is computed anew."""
    chain = _chain(record, steps, variances.length_s)
    filtered = chain.forward(variances.values)
    mean, covariance, _ = chain.backward(filtered, moments=True)
    d = record.d
    mean = mean * chain.units
    pick = slice(2 * d, 3 * d)
    units = chain.units[pick]
    return Estimate(
        q=mean[:, :d], v=mean[:, d : 2 * d], force=mean[:, pick], rate=mean[:, 3 * d : 4 * d],
        covariance=covariance[:, pick, pick] * units[:, None] * units,
        variances=replace(variances, log_likelihood=filtered[-1]),
    )  # fmt: skip


@dataclass(frozen=True)
class _Chain:
    """The arguments of the kernels, in scaled units; ``units`` (n,) leads back."""

    y: np.ndarray
    fresh: np.ndarray
    see: np.ndarray
    transition: np.ndarray
    offset: np.ndarray
    drive: np.ndarray
    colour: np.ndarray
    rate: float
    units: np.ndarray

    def forward(self, variances: np.ndarray) -> tuple:
        d = self.y.shape[1]
        start = np.repeat([START_POSITION, START_VELOCITY], d)
        return forward(
            self.y, self.fresh, self.see, self.transition, self.offset, self.drive, self.colour, variances,
            self.rate, start,
        )  # fmt: skip

    def backward(self, filtered: tuple, *, moments: bool) -> tuple:
        return backward(
            self.fresh, self.see, self.transition, self.drive, self.colour, self.rate, filtered, moments
        )


def _chain(record: Record, steps: Steps, length_s: float) -> _Chain:
    d, unit = record.d, record.unit_s
    n = 5 * d if record.ar1 > 0.0 else 4 * d
    rate = np.sqrt(3.0) / length_s
    h = record.h
    eye = np.eye(d)
    transition = np.zeros((len(h), n, n))
    transition[:, : 2 * d, : 2 * d] = steps.phi
    for part, gamma in zip((0.0, 0.5, 1.0), np.moveaxis(steps.gamma, 1, 0), strict=True):
        now, slope = matern_weights(rate, part * h)
        transition[:, : 2 * d, 2 * d : 3 * d] += now[:, None, None] * gamma
        transition[:, : 2 * d, 3 * d : 4 * d] += slope[:, None, None] * gamma
    fade = np.exp(-rate * h)
    own = np.array([[(1.0 + rate * h) * fade, h * fade], [-(rate**2) * h * fade, (1.0 - rate * h) * fade]])
    transition[:, 2 * d : 4 * d, 2 * d : 4 * d] = np.einsum("abt,ij->taibj", own, eye).reshape(
        -1, 2 * d, 2 * d
    )
    colour = np.zeros(len(h))
    see = np.concatenate([eye, np.zeros((d, n - d))], axis=1)
    if n == 5 * d:
        kept = record.ar1 ** (h / np.median(h[h > 0.0]))
        transition[:, 4 * d :, 4 * d :] = kept[:, None, None] * eye
        colour = 1.0 - kept**2
        see[:, 4 * d :] = eye
    units = np.concatenate([record.scale / unit**power for power in (0, 1, 2, 3, 0)[: n // d]])
    scaled = own * np.array([[1.0, 1.0 / unit], [unit, 1.0]])[..., None]
    still = np.diag([1.0, (rate * unit) ** 2])
    drive = still - np.einsum("abt,bc,dct->tad", scaled, still, scaled)
    offset = np.zeros((len(h), n))
    offset[:, : 2 * d] = steps.offset
    return _Chain(
        y=np.ascontiguousarray(record.y / record.scale), fresh=record.fresh, see=see,
        transition=np.ascontiguousarray(transition * units / units[:, None]), offset=offset / units,
        drive=np.ascontiguousarray(drive), colour=colour, rate=rate * unit, units=units,
    )  # fmt: skip
