"""Smoothed motions whose residual is written down rather than found."""

import numpy as np

from lagsplat.diagnose.residual.latent_force import LatentForceEstimate
from lagsplat.io.trajectory.trajectory import Trajectory

RATE_HZ = 60.0
STD = 0.1


def made(residual, seconds: float = 20.0, *, seed: int = 0, coordinates: int = 1, quiet=(), std: float = STD):
    """A motion of period one second, forced by ``u0``; ``residual`` of (t, q, v, u) gets smooth errors added.

    Errors have the standard deviation the result admits, and the colour that a smoother leaves.
    """
    rng = np.random.default_rng(seed)
    t = np.arange(round(seconds * RATE_HZ)) / RATE_HZ
    phase = rng.uniform(0, 2 * np.pi, (coordinates, 5))
    hertz = np.array([0.37, 0.83, 1.0, 1.07, 1.21])
    angles = 2 * np.pi * hertz * t[:, None, None] + phase
    size = np.array([0.3, 0.3, 0.6, 0.5, 0.4])
    q = (size * np.sin(angles)).sum(axis=2)
    v = (size * 2 * np.pi * hertz * np.cos(angles)).sum(axis=2)
    a = -(size * (2 * np.pi * hertz) ** 2 * np.sin(angles)).sum(axis=2)
    u = (np.sin(2 * np.pi * 0.61 * t) + 0.7 * np.sin(2 * np.pi * 1.7 * t + 1))[:, None]
    kernel = np.exp(-0.5 * (np.arange(-30, 31) / 6.0) ** 2)
    kernel /= np.sqrt(np.sum(kernel**2))
    errors = np.stack(
        [np.convolve(rng.standard_normal(len(t) + 60), kernel, "valid") for _ in range(coordinates)], axis=1
    )
    active = ~np.isin(np.arange(coordinates), quiet)
    true = np.broadcast_to(residual(t[:, None], q, v, u), q.shape)
    r = np.where(active, true + std * errors, 0.0)
    return LatentForceEstimate(
        motion=Trajectory(time_s=t, q=q, u=u, source=f"made {seed}"),
        q=q,
        v=v,
        a=a,
        residual=r,
        covariance=np.broadcast_to(std**2 * np.eye(coordinates), (len(t), coordinates, coordinates)),
        innovation=0.01 * rng.standard_normal(q.shape),
        evidence=np.where(active, 100.0, 0.0),
        noise=np.full(coordinates, 0.01),
        length_s=0.2,
    )


def no_force(t, q, v, u):
    return 0.0 * q
