"""A path, its hidden force and the variances of both, for steps that are linear.

Kalman filter of a mechanism with hidden forces, and the disturbance smoother behind it.

The state of d coordinates is (q, v, r, r', e), each (d,): position, velocity, hidden force, its rate, and
coloured measurement noise. Only q + e is observed. The smoother runs the recursion of the disturbances
backwards, which inverts no state covariance, and yields the derivative of the log-likelihood with respect to
every variance on the way.

Source: J. Durbin and S. J. Koopman, Time Series Analysis by State Space Methods, 2nd ed., 4.3-4.5 and 7.3.3.
"""

import math
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64
from numba import njit
from scipy.optimize import minimize
from scipy.stats import median_abs_deviation

from lagsplat.diagnose.residual.linearization import LinearSteps

FORCE_BOUNDS = (1e-10, 1e4)  # variance of the force, over the square of what swings the motion
NOISE_BOUNDS = (1e-14, 1.0)  # variance of the noise, over the motion's
START_POSITION_VARIANCE, START_VELOCITY_VARIANCE = 1.0, 25.0  # variances at a clip's start, over the motion's
MAX_OPTIMIZER_STEPS = 40


@dataclass(frozen=True)
class SmootherData:
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
class ForceVariances:
    """Length scale of the hidden force [s], and variances (2d,) of the forces, then of the noise, each over
    the square of its `SmootherData` scale, with the log-likelihood they reach (nats)."""

    length_s: float
    values: np.ndarray
    log_likelihood: float = -np.inf


@dataclass(frozen=True)
class SmoothedPath:
    """Smoothed ``q``, ``v``, hidden ``force``, its ``rate`` (T, d) and its ``covariance`` (T, d, d)."""

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
    """Weights of the value and of the derivative now in the expected value ``h`` later, Matern-3/2."""
    fade = np.exp(-rate * h)
    return (1.0 + rate * h) * fade, h * fade


def guess_variances(record: SmootherData, length_s: float) -> ForceVariances:
    """Noise from fourth differences of each clip, forces as large as what swings the motion."""
    cuts = np.flatnonzero(record.fresh)[1:]
    fourth = np.concatenate([np.diff(clip, n=4, axis=0) for clip in np.split(record.y, cuts)])
    noise = median_abs_deviation(fourth, axis=0, scale="normal") ** 2 / 70.0 / record.scale**2
    values = np.concatenate([np.ones(record.d), np.clip(noise, 100 * NOISE_BOUNDS[0], 0.01)])
    return ForceVariances(length_s, values)


def maximize_likelihood(
    record: SmootherData, steps: LinearSteps, start: ForceVariances, *, noise_known: bool = False
) -> ForceVariances:
    """Variances of largest marginal likelihood at ``start``'s length scale, sought from its values."""
    chain = _build_model(record, steps, start.length_s)
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
        options={"maxiter": MAX_OPTIMIZER_STEPS, "ftol": 1e-7, "gtol": 1e-2},
    )  # fmt: skip
    values[free] = found.x
    return replace(start, values=np.exp(values), log_likelihood=-float(found.fun))


def compute_force_evidence(
    record: SmootherData, steps: LinearSteps, variances: ForceVariances
) -> Float64[np.ndarray, " d"]:
    """Nats by which each coordinate's force makes the record more likely than without it."""
    chain = _build_model(record, steps, variances.length_s)
    full = chain.forward(variances.values)[-1]
    without = []
    for i in range(record.d):
        values = variances.values.copy()
        values[i] = FORCE_BOUNDS[0]
        without.append(chain.forward(values)[-1])
    return full - np.array(without)


def smooth_path(record: SmootherData, steps: LinearSteps, variances: ForceVariances) -> SmoothedPath:
    """Smoothed path and force under given variances; their likelihood is computed anew."""
    chain = _build_model(record, steps, variances.length_s)
    filtered = chain.forward(variances.values)
    mean, covariance, _ = chain.backward(filtered, moments=True)
    d = record.d
    mean = mean * chain.units
    pick = slice(2 * d, 3 * d)
    units = chain.units[pick]
    return SmoothedPath(
        q=mean[:, :d], v=mean[:, d : 2 * d], force=mean[:, pick], rate=mean[:, 3 * d : 4 * d],
        covariance=covariance[:, pick, pick] * units[:, None] * units,
        variances=replace(variances, log_likelihood=filtered[-1]),
    )  # fmt: skip


@dataclass(frozen=True)
class _LinearGaussianModel:
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
        start = np.repeat([START_POSITION_VARIANCE, START_VELOCITY_VARIANCE], d)
        return filter_forward(
            self.y, self.fresh, self.see, self.transition, self.offset, self.drive, self.colour, variances,
            self.rate, start,
        )  # fmt: skip

    def backward(self, filtered: tuple, *, moments: bool) -> tuple:
        return smooth_backward(
            self.fresh, self.see, self.transition, self.drive, self.colour, self.rate, filtered, moments
        )


def _build_model(record: SmootherData, steps: LinearSteps, length_s: float) -> _LinearGaussianModel:
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
    return _LinearGaussianModel(
        y=np.ascontiguousarray(record.y / record.scale), fresh=record.fresh, see=see,
        transition=np.ascontiguousarray(transition * units / units[:, None]), offset=offset / units,
        drive=np.ascontiguousarray(drive), colour=colour, rate=rate * unit, units=units,
    )  # fmt: skip


@njit(cache=True)
def _multiply(a, b, out):
    """out = a b; a's zeros are passed over, because transitions are mostly empty."""
    rows, inner = a.shape
    columns = b.shape[1]
    for i in range(rows):
        for j in range(columns):
            out[i, j] = 0.0
        for k in range(inner):
            factor = a[i, k]
            if factor != 0.0:
                for j in range(columns):
                    out[i, j] += factor * b[k, j]


@njit(cache=True)
def _multiply_transposed(a, b, out):
    """out = a b^T, with b's zeros passed over."""
    rows = a.shape[0]
    columns, inner = b.shape
    for i in range(rows):
        for j in range(columns):
            out[i, j] = 0.0
    for j in range(columns):
        for k in range(inner):
            factor = b[j, k]
            if factor != 0.0:
                for i in range(rows):
                    out[i, j] += a[i, k] * factor


@njit(cache=True)
def _transposed_multiply(a, b, out):
    """out = a^T b, with a's zeros passed over."""
    inner, rows = a.shape
    columns = b.shape[1]
    for i in range(rows):
        for j in range(columns):
            out[i, j] = 0.0
    for k in range(inner):
        for i in range(rows):
            factor = a[k, i]
            if factor != 0.0:
                for j in range(columns):
                    out[i, j] += factor * b[k, j]


@njit(cache=True)
def _set_start(x, p, y, start, variances, rate):
    """Position near the first sample, all else unknown but for its size."""
    d = len(y)
    x[:] = 0.0
    p[:] = 0.0
    for i in range(d):
        x[i] = y[i]
        p[i, i] = start[i]
        p[d + i, d + i] = start[d + i]
        p[2 * d + i, 2 * d + i] = variances[i]
        p[3 * d + i, 3 * d + i] = rate * rate * variances[i]
        if len(x) == 5 * d:
            p[4 * d + i, 4 * d + i] = variances[d + i]


@njit(cache=True)
def _observe(x, p, y, see, variances, innovation, inverse, gain):
    """Fill the innovation (d,), its inverse covariance (d, d) and the gain (n, d); return its log density."""
    d = len(y)
    n = len(x)
    cross = np.empty((n, d))
    s = np.empty((d, d))
    _multiply_transposed(p, see, cross)
    _multiply(see, cross, s)
    for j in range(d):
        innovation[j] = y[j]
        for i in range(n):
            innovation[j] -= see[j, i] * x[i]
        if n == 4 * d:
            s[j, j] += variances[d + j]
    inverse[:] = np.linalg.inv(s)
    _multiply(cross, inverse, gain)
    quadratic = 0.0
    for i in range(d):
        for j in range(d):
            quadratic += innovation[i] * inverse[i, j] * innovation[j]
    return cross, -0.5 * (quadratic + math.log(np.linalg.det(s)) + d * math.log(2.0 * math.pi))


@njit(cache=True)
def _advance(x, p, cross, innovation, gain, transition, offset, drive, colour, variances, half):
    """Take what was observed into account, then step to the next sample, in place."""
    d = len(innovation)
    n = len(x)
    updated = x.copy()
    for i in range(n):
        for j in range(d):
            updated[i] += gain[i, j] * innovation[j]
            for k in range(n):
                p[i, k] -= gain[i, j] * cross[k, j]
    for i in range(n):
        x[i] = offset[i]
        for k in range(n):
            x[i] += transition[i, k] * updated[k]
    _multiply_transposed(p, transition, half)
    _multiply(transition, half, p)
    for i in range(d):
        for a in range(2):
            for b in range(2):
                p[(2 + a) * d + i, (2 + b) * d + i] += drive[a, b] * variances[i]
        if n == 5 * d:
            p[4 * d + i, 4 * d + i] += colour * variances[d + i]
    for i in range(n):
        for k in range(i):
            p[i, k] = p[k, i] = 0.5 * (p[i, k] + p[k, i])


@njit(cache=True)
def filter_forward(y, fresh, see, transition, offset, drive, colour, variances, rate, start):
    """Predictions (T, n), their covariances (T, n, n), innovations (T, d), inverse innovation covariances
    (T, d, d), gains (T, n, d) and the log-likelihood.

    ``y`` (T, d); ``fresh`` (T,) True where a clip begins; ``see`` (d, n) tells what of the state is observed;
    ``transition`` (T, n, n) and ``offset`` (T, n) lead from a sample to the next; ``drive`` (T, 2, 2) is the
    process noise of (r, r') for a force of variance one, ``colour`` (T,) that of e; ``variances`` (2d,) of
    the forces, then of the measurement noise; ``rate`` is Matern's lambda; ``start`` (2d,) variances of the
    first q and v. n is 4d for white noise, 5d for coloured.
    """
    length, d = y.shape
    n = transition.shape[1]
    mean = np.zeros((length, n))
    covariance = np.zeros((length, n, n))
    innovation = np.zeros((length, d))
    inverse = np.zeros((length, d, d))
    gain = np.zeros((length, n, d))
    half = np.zeros((n, n))
    x = np.zeros(n)
    p = np.zeros((n, n))
    likelihood = 0.0
    for t in range(length):
        if fresh[t]:
            _set_start(x, p, y[t], start, variances, rate)
        mean[t] = x
        covariance[t] = p
        cross, density = _observe(x, p, y[t], see, variances, innovation[t], inverse[t], gain[t])
        likelihood += density
        if t + 1 < length and not fresh[t + 1]:
            _advance(x, p, cross, innovation[t], gain[t], transition[t], offset[t], drive[t], colour[t],
                     variances, half)  # fmt: skip
    return mean, covariance, innovation, inverse, gain, likelihood


@njit(cache=True)
def _propagate_backward(r, big, transition, half):
    """r = A^T r and N = A^T N A, in place."""
    n = len(r)
    pulled = np.zeros(n)
    for i in range(n):
        for k in range(n):
            pulled[k] += transition[i, k] * r[i]
    r[:] = pulled
    _transposed_multiply(transition, big, half)
    _multiply(half, transition, big)


@njit(cache=True)
def _update_backward(r, big, see, innovation, inverse, gain, score, half):
    """r and N before an observation from those after it, in place; adds the white noise's derivative."""
    n = len(r)
    d = len(innovation)
    back = np.empty(d)
    shrunk = np.empty((n, d))
    middle = np.empty((d, d))
    _multiply(big, gain, shrunk)
    _transposed_multiply(gain, shrunk, middle)
    for i in range(d):
        u = 0.0
        for j in range(d):
            middle[i, j] += inverse[i, j]
            u += inverse[i, j] * innovation[j]
        for k in range(n):
            u -= gain[k, i] * r[k]
        back[i] = u
    for i in range(d):
        if n == 4 * d:
            score[d + i] += 0.5 * (back[i] ** 2 - middle[i, i])
        for k in range(n):
            r[k] += see[i, k] * back[i]
    # N <- L^T N L + Z^T F^-1 Z with L = I - K Z
    wide = np.empty((d, n))
    _multiply(middle, see, wide)
    for j in range(d):
        for k in range(n):
            wide[j, k] *= 0.5
            wide[j, k] -= shrunk[k, j]
    both = np.empty((n, n))
    _transposed_multiply(see, wide, both)
    for i in range(n):
        for k in range(n):
            half[i, k] = big[i, k] + both[i, k] + both[k, i]
    for i in range(n):
        for k in range(n):
            big[i, k] = 0.5 * (half[i, k] + half[k, i])


@njit(cache=True)
def _add_scores(score, r, big, drive, colour):
    """Derivatives with respect to the variances of what drives a step."""
    d = len(score) // 2
    for i in range(d):
        for a in range(2):
            for b in range(2):
                row, column = (2 + a) * d + i, (2 + b) * d + i
                score[i] += 0.5 * drive[a, b] * (r[row] * r[column] - big[row, column])
        if len(r) == 5 * d:
            e = 4 * d + i
            score[d + i] += 0.5 * colour * (r[e] * r[e] - big[e, e])


@njit(cache=True)
def smooth_backward(fresh, see, transition, drive, colour, rate, filtered, moments):
    """Smoothed means (T, n) and covariances (T, n, n), and the derivatives (2d,) of the log-likelihood with
    respect to the variances.

    ``filtered`` is what `filter_forward` returned. Without ``moments`` the first two stay empty.
    """
    mean, covariance, innovation, inverse, gain, _ = filtered
    length, n = mean.shape
    kept = length if moments else 0
    smooth_mean = np.zeros((kept, n))
    smooth_covariance = np.zeros((kept, n, n))
    score = np.zeros(2 * innovation.shape[1])
    at_start = np.diag(np.array([1.0, rate * rate]))
    r = np.zeros(n)
    big = np.zeros((n, n))
    half = np.zeros((n, n))
    back = np.zeros((n, n))
    for t in range(length - 1, -1, -1):
        if t + 1 == length or fresh[t + 1]:
            r[:] = 0.0
            big[:] = 0.0
        else:
            _add_scores(score, r, big, drive[t], colour[t])
            _propagate_backward(r, big, transition[t], half)
        _update_backward(r, big, see, innovation[t], inverse[t], gain[t], score, half)
        if fresh[t]:
            _add_scores(score, r, big, at_start, 1.0)
        if moments:
            p = covariance[t]
            _multiply(p, big, half)
            _multiply(half, p, back)
            for i in range(n):
                smooth_mean[t, i] = mean[t, i]
                for k in range(n):
                    smooth_mean[t, i] += p[i, k] * r[k]
                    smooth_covariance[t, i, k] = p[i, k] - back[i, k]
    return smooth_mean, smooth_covariance, score
