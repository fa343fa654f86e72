# mypy: ignore-errors
"""Compiled Kalman filter of linear Gaussian steps, and the disturbance smoother behind it.

Sample t of T has a state (n,), of which the first d entries are observed with white noise:

    x_t = A_t x_{t-1} + c_t + w_t,  y_t = Z x_t + e_t,  cov w_t = Q_t,  cov e_t = diag(noise).

A clip begins where A_t is zero; Q_t is then the covariance of its first state. The smoother runs the
recursion of the disturbances backwards, which inverts no state covariance and yields the derivative of the
log-likelihood by every variance on the way. Numba infers the types, so functions carry no annotations.

Source: J. Durbin and S. J. Koopman, Time Series Analysis by State Space Methods, 2nd ed., 4.3-4.5 and 7.3.3,
whose symbols are T for ``transition``, v for ``innovation``, F for its covariance, N for ``information``.
"""

import numpy as np
from numba import njit


@njit(cache=True)
def _multiply(a, b, out):
    """Write ``a b`` to ``out``; zeros of ``a`` are skipped, because transition matrices are mostly empty."""
    out[:] = 0.0
    for i in range(a.shape[0]):
        for k in range(a.shape[1]):
            if a[i, k] != 0.0:
                for j in range(b.shape[1]):
                    out[i, j] += a[i, k] * b[k, j]


@njit(cache=True)
def filter_forward(y, transition, offset, process, noise):
    """Run the Kalman filter; all vectors are columns.

    Args:
        y: observations (T, d, 1).
        transition, offset: A (T, n, n) and c (T, n, 1), from the sample before.
        process: covariances Q (T, n, n).
        noise: variances (d,) of the measurement noise.

    Returns:
        Predicted means (T, n, 1), their covariances (T, n, n), innovations (T, d, 1), the inverses of their
        covariances (T, d, d) and gains (T, n, d).
    """
    length, d, n = len(y), y.shape[1], offset.shape[1]
    mean, covariance = np.empty((length, n, 1)), np.empty((length, n, n))
    innovation, inverse, gain = np.empty((length, d, 1)), np.empty((length, d, d)), np.empty((length, n, d))
    x, p, part, white = np.zeros((n, 1)), np.zeros((n, n)), np.empty((n, n)), np.diag(noise)
    for t in range(length):
        _multiply(transition[t], x, mean[t])
        mean[t] += offset[t]
        _multiply(transition[t], p, part)
        _multiply(transition[t], part.T, p)
        p += process[t]
        p = 0.5 * (p + p.T)
        covariance[t] = p
        cross = p[:, :d].copy()
        innovation[t] = y[t] - mean[t, :d]
        inverse[t] = np.linalg.inv(cross[:d] + white)
        _multiply(cross, inverse[t], gain[t])
        _multiply(gain[t], innovation[t], x)
        x += mean[t]
        _multiply(gain[t], cross.T, part)
        p -= part
    return mean, covariance, innovation, inverse, gain


@njit(cache=True)
def smooth_backward(transition, innovation, inverse, gain):
    """Run the disturbance smoother backwards over what `filter_forward` returned.

    Returns:
        r (T, n, 1) and N (T, n, n), by which the smoothed mean is m + P r and its covariance P - P N P, with
        predicted m and P; and the derivatives (d,) of the log-likelihood by ``noise``.
    """
    length, n, d = gain.shape
    r, information, score = np.zeros((length, n, 1)), np.zeros((length, n, n)), np.zeros(d)
    part, shrunk, precision = np.empty((n, n)), np.empty((n, d)), np.empty((d, d))
    error, pulled = np.empty((d, 1)), np.empty((d, 1))
    for t in range(length - 1, -1, -1):
        now, weight = r[t], information[t]
        if t + 1 < length:
            back = transition[t + 1].T
            _multiply(back, r[t + 1], now)
            _multiply(back, information[t + 1], part)
            _multiply(part, transition[t + 1], weight)
        _multiply(weight, gain[t], shrunk)
        _multiply(gain[t].T, shrunk, precision)
        precision += inverse[t]
        _multiply(inverse[t], innovation[t], error)
        _multiply(gain[t].T, now, pulled)
        error -= pulled
        score += 0.5 * (error[:, 0] ** 2 - np.diag(precision))
        now[:d] += error
        # N <- L^T N L + Z^T F^-1 Z with L = I - K Z
        weight[:, :d] -= shrunk
        weight[:d] -= shrunk.T
        weight[:d, :d] += precision
        weight[:] = 0.5 * (weight + weight.T)
    return r, information, score
