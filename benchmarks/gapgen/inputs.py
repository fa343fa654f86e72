"""Excitations a careful user would record, and what an imperfect actuation path makes of them."""

from itertools import pairwise

import numpy as np
from numba import njit
from numpy.typing import NDArray

from benchmarks.gapgen.laws import soft_dead_band

Array = NDArray[np.float64]
KINDS = ("multisine", "steps", "triangle", "chirp")
SINE = "sine"


def _multisine(t: Array, f1: float, rng: np.random.Generator) -> Array:
    f = rng.uniform(0.12, 2.6, 9) * f1
    phase = rng.uniform(0.0, 2.0 * np.pi, 9)
    weight = 1.0 / (1.0 + 1.5 * np.exp(-(((f / f1 - 1.0) / 0.25) ** 2)))
    return (weight[:, None] * np.sin(2.0 * np.pi * f[:, None] * t + phase[:, None])).sum(0) / 2.5


def _steps(t: Array, f1: float, rng: np.random.Generator) -> Array:
    edges = t[0] + np.cumsum(rng.uniform(0.7, 3.0, 400) / f1)
    levels = rng.uniform(-1.0, 1.0, 401)
    levels[rng.random(401) < 0.15] = 0.0
    return levels[np.searchsorted(edges, t)]


def _triangle(t: Array, f1: float, rng: np.random.Generator) -> Array:
    f = rng.uniform(0.12, 0.35) * f1
    phase = (f * (t - t[0]) + rng.random()) % 1.0
    swell = rng.uniform(0.4, 1.0) + 0.5 * (t - t[0]) / max(t[-1] - t[0], 1e-9)
    return swell * (4.0 * np.abs(phase - 0.5) - 1.0) * 1.3


def _chirp(t: Array, f1: float, rng: np.random.Generator) -> Array:
    span = max(t[-1] - t[0], 1e-9)
    s = (t - t[0]) / span
    low, high = 0.2 * f1, rng.uniform(1.6, 2.6) * f1
    if rng.random() < 0.5:
        low, high = high, low
    phase = 2.0 * np.pi * span * (low * s + 0.5 * (high - low) * s**2)
    return np.sin(phase + rng.uniform(0.0, 2.0 * np.pi))


def excitation(t: Array, f1: float, n_u: int, rng: np.random.Generator, *, kinds: tuple[str, ...]) -> Array:
    """Inputs (T, n_u) of about unit size: a sequence of the given kinds with rests and several levels."""
    makers = {"multisine": _multisine, "steps": _steps, "triangle": _triangle, "chirp": _chirp}
    out = np.zeros((len(t), n_u))
    span = t[-1] - t[0]
    n = int(np.clip(round(span / (6.0 / f1)), 1, 9))
    edges = np.linspace(0, len(t), n + 1).astype(int)
    levels = rng.permutation(np.resize([1.0, 0.45, 0.75, 1.0, 0.25], n))
    levels[0] = max(levels[0], 0.45)
    for k, (a, z) in enumerate(pairwise(edges)):
        for j in range(n_u):
            kind = kinds[(k + j) % len(kinds)]
            out[a:z, j] = levels[k] * makers[kind](t[a:z], f1, rng)
        if n >= 4 and k == n // 2:
            out[a + (z - a) // 2 : z] = 0.0
    return out


def pure_sine(t: Array, f1: float, n_u: int, rng: np.random.Generator) -> Array:
    """Inputs (T, n_u) of one frequency around ``f1`` [Hz] throughout, each with a phase of its own."""
    omega = 2.0 * np.pi * f1 * np.exp(rng.uniform(np.log(0.35), np.log(1.8)))
    return np.sin(omega * t[:, None] + rng.uniform(0.0, 2.0 * np.pi, n_u)) * rng.uniform(0.5, 1.0, n_u)


def on_half_steps(u: Array, n_sub: int) -> Array:
    """Inputs (T, n_u) interpolated linearly to half steps, (2 (T - 1) n_sub + 1, n_u)."""
    n = len(u)
    fine = np.linspace(0.0, n - 1.0, 2 * (n - 1) * n_sub + 1)
    return np.column_stack([np.interp(fine, np.arange(n), u[:, j]) for j in range(u.shape[1])])


def shifted(u: Array, seconds: Array, step_s: float) -> Array:
    """One input (T,) as it was ``seconds`` (scalar or (T,)) earlier; the ends are held."""
    at = np.arange(len(u)) - seconds / step_s
    return np.interp(at, np.arange(len(u)), u)


@njit(cache=True)
def two_pole_lag(u, slow, fast, h):
    """Two first-order lags in a row, exact for inputs held at the mean of each step."""
    out = np.empty_like(u)
    a, b = u[0], u[0]
    decay_a, decay_b = np.exp(-h / slow), np.exp(-h / fast)
    out[0] = u[0]
    for k in range(1, len(u)):
        a = decay_a * a + (1.0 - decay_a) * 0.5 * (u[k] + u[k - 1])
        b = decay_b * b + (1.0 - decay_b) * a
        out[k] = b
    return out


@njit(cache=True)
def rounded_dead_zone(u, half):
    """Dead zone with rounded corners."""
    out = np.empty_like(u)
    for k in range(len(u)):
        out[k] = soft_dead_band(u[k], half, 0.12 * half)
    return out


@njit(cache=True)
def gear_train(u, width):
    """Mean of three plays in parallel whose widths lie around ``width``."""
    out = np.zeros_like(u)
    for share in (0.85, 1.0, 1.15):
        half = 0.5 * share * width
        x = u[0]
        for k in range(len(u)):
            x = min(max(x, u[k] - half), u[k] + half)
            out[k] += x / 3.0
    return out


@njit(cache=True)
def resonant_valve(u, omega, zeta, h):
    """An underdamped second-order actuator of unit static gain."""
    out = np.empty_like(u)
    x, v = u[0], 0.0
    for k in range(len(u)):
        out[k] = x
        v += h * (omega * omega * (u[k] - x) - 2.0 * zeta * omega * v)
        x += h * v
    return out


def through_actuator(u: Array, operator: str, numbers: dict[str, float], step_s: float) -> Array:
    """What one input channel (T,) becomes on its way; ``u`` is sampled every ``step_s``.

    Raises:
        ValueError: if no such operator exists.
    """
    if operator == "gain":
        return numbers["ratio"] * u
    if operator == "lag":
        return two_pole_lag(u, 0.85 * numbers["time_constant"], 0.15 * numbers["time_constant"], step_s)
    if operator == "shift":
        wander = 1.0 + 0.04 * np.sin(2.0 * np.pi * 0.07 * step_s * np.arange(len(u)) + numbers["phase"])
        return shifted(u, numbers["seconds"] * wander, step_s)
    if operator == "dead_zone":
        return rounded_dead_zone(u, numbers["half_width"])
    if operator == "soft_limit":
        power = numbers["sharpness"]
        return u / (1.0 + np.abs(u / numbers["limit"]) ** power) ** (1.0 / power)
    if operator == "backlash":
        return gear_train(u, numbers["width"])
    if operator == "rectified":
        return u + numbers["share"] * u**2 / numbers["scale"]
    if operator == "resonant":
        return resonant_valve(u, numbers["omega"], numbers["zeta"], step_s)
    raise ValueError(f"input operator {operator!r}: none such")
