# mypy: ignore-errors
"""Compiled Kalman filter of a mechanism with latent forces, and the disturbance smoother behind it.

The state of d coordinates is (q, v, r, r'), each (d,) and n = 4d together: position, velocity, latent force
and its rate. Only q is observed, with white noise. The smoother runs the recursion of the disturbances
backwards, which inverts no state covariance, and yields the derivative of the log-likelihood with respect to
every variance on the way. Numba compiles these functions and infers their types, so they carry no
annotations.

Names follow the source: ``transition`` is T, ``innovation`` v, ``inverse`` the inverse of F, ``information``
N; Z picks q.

Source: J. Durbin and S. J. Koopman, Time Series Analysis by State Space Methods, 2nd ed., 4.3-4.5 and 7.3.3.
"""

import math

import numpy as np
from numba import njit


@njit(cache=True)
def _multiply(a, b, out):
    """Write ``a b`` to ``out``; zeros of ``a`` are skipped, because transition matrices are mostly empty."""
    rows, inner = a.shape
    out[:] = 0.0
    for i in range(rows):
        for k in range(inner):
            factor = a[i, k]
            if factor != 0.0:
                for j in range(b.shape[1]):
                    out[i, j] += factor * b[k, j]


@njit(cache=True)
def _set_start(x, p, y, start, variances, rate):
    """Start a clip in place: position near the first sample, all else known only by its variance."""
    d = len(y)
    x[:] = 0.0
    x[:d] = y
    p[:] = 0.0
    for i in range(d):
        p[i, i] = start[i]
        p[d + i, d + i] = start[d + i]
        p[2 * d + i, 2 * d + i] = variances[i]
        p[3 * d + i, 3 * d + i] = rate * rate * variances[i]


@njit(cache=True)
def _observe(x, p, y, variances, innovation, inverse, gain):
    """Fill innovation (d,), inverse covariance (d, d) and gain (n, d) of one sample, from the prediction.

    Returns the covariance (n, d) of state and observation, and the log density of the innovation.
    """
    d = len(y)
    cross = p[:, :d].copy()
    s = cross[:d].copy()
    innovation[:] = y - x[:d]
    for j in range(d):
        s[j, j] += variances[d + j]
    inverse[:] = np.linalg.inv(s)
    _multiply(cross, inverse, gain)
    quadratic = 0.0
    for i in range(d):
        for j in range(d):
            quadratic += innovation[i] * inverse[i, j] * innovation[j]
    return cross, -0.5 * (quadratic + math.log(np.linalg.det(s)) + d * math.log(2.0 * math.pi))


@njit(cache=True)
def _advance(x, p, cross, innovation, gain, transition, offset, drive, variances, work):
    """Condition the prediction on the observation, then predict the next sample; all in place."""
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
    _multiply(transition, p.T, work.T)
    _multiply(transition, work, p)
    for i in range(d):
        for a in range(2):
            for b in range(2):
                p[(2 + a) * d + i, (2 + b) * d + i] += drive[a, b] * variances[i]
    p[:] = 0.5 * (p + p.T)


@njit(cache=True)
def filter_forward(y, starts, transition, offset, drive, variances, rate, start):
    """Run the Kalman filter over all clips.

    Args:
        y: observations (T, d).
        starts: (T,) True where a clip begins.
        transition: (T, n, n), from each sample to the next.
        offset: (T, n), added to the state on the way.
        drive: (T, 2, 2) process noise of (r, r') for a force of variance one.
        variances: (2d,) of the forces, then of the measurement noise.
        rate: decay rate of the Matern-3/2 covariance of the forces.
        start: (2d,) variances of the first q and v of a clip.

    Returns:
        Predicted means (T, n), their covariances (T, n, n), innovations (T, d), the inverses of their
        covariances (T, d, d), gains (T, n, d) and the log-likelihood [nats].
    """
    length, d = y.shape
    n = transition.shape[1]
    mean = np.zeros((length, n))
    covariance = np.zeros((length, n, n))
    innovation = np.zeros((length, d))
    inverse = np.zeros((length, d, d))
    gain = np.zeros((length, n, d))
    work = np.zeros((n, n))
    x = np.zeros(n)
    p = np.zeros((n, n))
    likelihood = 0.0
    for t in range(length):
        if starts[t]:
            _set_start(x, p, y[t], start, variances, rate)
        mean[t] = x
        covariance[t] = p
        cross, density = _observe(x, p, y[t], variances, innovation[t], inverse[t], gain[t])
        likelihood += density
        if t + 1 < length and not starts[t + 1]:
            _advance(x, p, cross, innovation[t], gain[t], transition[t], offset[t], drive[t], variances, work)
    return mean, covariance, innovation, inverse, gain, likelihood


@njit(cache=True)
def _propagate_backward(r, information, transition, work):
    """Carry ``r`` and ``information`` back over a step, in place: A^T r and A^T N A."""
    n = len(r)
    pulled = np.zeros(n)
    for i in range(n):
        for k in range(n):
            pulled[k] += transition[i, k] * r[i]
    r[:] = pulled
    _multiply(transition.T, information, work)
    _multiply(work, transition, information)


@njit(cache=True)
def _update_backward(r, information, innovation, inverse, gain, score, work):
    """Carry ``r`` and ``information`` back over an observation, in place.

    Adds the derivatives by the variances of white measurement noise to ``score``.
    """
    n = len(r)
    d = len(innovation)
    back = np.empty(d)
    shrunk = np.empty((n, d))
    middle = np.empty((d, d))
    _multiply(information, gain, shrunk)
    _multiply(gain.T, shrunk, middle)
    for i in range(d):
        u = 0.0
        for j in range(d):
            middle[i, j] += inverse[i, j]
            u += inverse[i, j] * innovation[j]
        for k in range(n):
            u -= gain[k, i] * r[k]
        back[i] = u
    for i in range(d):
        score[d + i] += 0.5 * (back[i] ** 2 - middle[i, i])
        r[i] += back[i]
    # N <- L^T N L + Z^T F^-1 Z with L = I - K Z
    both = np.zeros((n, n))
    for j in range(d):
        for k in range(n):
            both[j, k] = (0.5 * middle[j, k] if k < d else 0.0) - shrunk[k, j]
    work[:] = information + both + both.T
    information[:] = 0.5 * (work + work.T)


@njit(cache=True)
def _add_scores(score, r, information, drive):
    """Add the derivatives of the log-likelihood by the variances that drive a step to ``score`` (2d,)."""
    d = len(score) // 2
    for i in range(d):
        for a in range(2):
            for b in range(2):
                row, column = (2 + a) * d + i, (2 + b) * d + i
                score[i] += 0.5 * drive[a, b] * (r[row] * r[column] - information[row, column])


@njit(cache=True)
def smooth_backward(starts, transition, drive, rate, filtered, moments):
    """Run the disturbance smoother backwards over what `filter_forward` returned, with its arguments.

    Returns:
        Smoothed means (T, n) and covariances (T, n, n), empty unless ``moments`` are asked for, and the
        derivatives (2d,) of the log-likelihood by the variances.
    """
    mean, covariance, innovation, inverse, gain, _ = filtered
    length, n = mean.shape
    kept = length if moments else 0
    smooth_mean = np.zeros((kept, n))
    smooth_covariance = np.zeros((kept, n, n))
    score = np.zeros(2 * innovation.shape[1])
    at_start = np.diag(np.array([1.0, rate * rate]))
    r = np.zeros(n)
    information = np.zeros((n, n))
    work = np.zeros((n, n))
    back = np.zeros((n, n))
    for t in range(length - 1, -1, -1):
        if t + 1 == length or starts[t + 1]:
            r[:] = 0.0
            information[:] = 0.0
        else:
            _add_scores(score, r, information, drive[t])
            _propagate_backward(r, information, transition[t], work)
        _update_backward(r, information, innovation[t], inverse[t], gain[t], score, work)
        if starts[t]:
            _add_scores(score, r, information, at_start)
        if moments:
            p = covariance[t]
            _multiply(p, information, work)
            _multiply(work, p, back)
            smooth_covariance[t] = p - back
            for i in range(n):
                smooth_mean[t, i] = mean[t, i]
                for k in range(n):
                    smooth_mean[t, i] += p[i, k] * r[k]
    return smooth_mean, smooth_covariance, score
