"""Noise and velocity of a recorded motion, by local cubics in true time."""

import numpy as np
from jaxtyping import Float64, Int64


def local_cubic(
    time: Float64[np.ndarray, " N"],
    q: Float64[np.ndarray, "N d"],
    clips: Int64[np.ndarray, "C 2"],
    *,
    width_s: float,
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Value, slope and curvature (N, d) of the cubic fitted to the samples about each one.

    The fit spans ``width_s`` or nine samples, whichever is more, and is one-sided where a clip ends.
    """
    smooth, slope, bend = np.empty_like(q), np.empty_like(q), np.empty_like(q)
    for start, stop in clips:
        n = stop - start
        dt = (time[stop - 1] - time[start]) / max(n - 1, 1)
        half = int(min(max(round(0.5 * width_s / max(dt, 1e-12)), 4), (n - 1) // 2))
        if n < 5:
            smooth[start:stop] = q[start:stop]
            slope[start:stop] = np.gradient(q[start:stop], time[start:stop], axis=0) if n > 1 else 0.0
            bend[start:stop] = 0.0
            continue
        centre = np.clip(np.arange(n), half, n - 1 - half)
        index = start + centre[:, None] + np.arange(-half, half + 1)[None, :]
        x = (time[index] - time[start:stop, None]) / (half * dt)
        degree = 3 if 2 * half + 1 > 5 else 2
        powers = x[..., None] ** np.arange(degree + 1)
        gram = np.einsum("nka,nkb->nab", powers, powers)
        moment = np.einsum("nka,nkd->nad", powers, q[index])
        solved = np.linalg.solve(gram, moment)
        smooth[start:stop], slope[start:stop] = solved[:, 0], solved[:, 1] / (half * dt)
        bend[start:stop] = 2.0 * solved[:, 2] / (half * dt) ** 2
    return smooth, slope, bend


def noise_level(
    time: Float64[np.ndarray, " N"],
    q: Float64[np.ndarray, "N d"],
    clips: Int64[np.ndarray, "C 2"],
    *,
    width_s: float,
) -> Float64[np.ndarray, " d"]:
    """Standard deviation of the noise of each coordinate, robust to a few outliers.

    The residual of a local cubic, corrected for what the fit takes of white noise (Savitzky-Golay
    centre weight ``(3/4)(3 m^2 - 7) / (m (m^2 - 4))`` of ``m`` samples).
    """
    residuals = []
    for start, stop in clips:
        n = stop - start
        dt = (time[stop - 1] - time[start]) / max(n - 1, 1)
        half = int(min(max(round(0.5 * width_s / max(dt, 1e-12)), 4), (n - 1) // 2))
        if half < 4:
            continue
        clip = np.array([[0, n]])
        smooth = local_cubic(time[start:stop], q[start:stop], clip, width_s=width_s)[0]
        m = 2 * half + 1
        kept = 1.0 - 0.75 * (3.0 * m * m - 7.0) / (m * (m * m - 4.0))
        residuals.append((q[start:stop] - smooth)[half : n - half] / np.sqrt(kept))
    if not residuals:
        return np.full(q.shape[1], np.nan)
    every = np.concatenate(residuals)
    middle = 1.4826 * np.median(np.abs(every), axis=0)
    inside = np.abs(every) <= 4.0 * middle
    return np.sqrt(np.sum(np.where(inside, every, 0.0) ** 2, axis=0) / np.maximum(inside.sum(axis=0), 1))
