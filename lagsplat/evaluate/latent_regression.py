"""Laws of the next frame that are regressed on encoded states, velocities and inputs, each by one fit.

They know no mechanics and advance by one frame a step, whatever the time between two frames.
"""

import warnings
from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float64, Int64

from lagsplat.evaluate.protocol import (
    EvaluationSeries,
    Integrate,
    initial_states,
    roll_out,
    squared_norm,
)
from lagsplat.integer_lists import choose_evenly, list_powers

DEGREES = (1, 2, 3)  # of the monomials among which a Koopman law is chosen
KEPT_BACK = 0.2  # share of the training frames, the last ones, by which it is chosen
COMPARED = 200  # forecasts by which it is chosen
MOST_POINTS = 400  # of a Gaussian process: its fit takes their cube

States = Float64[np.ndarray, "B n"]


def select_frames(train: EvaluationSeries, *, ahead: int) -> np.ndarray:
    """Training frames of which the velocity is known and which have ``ahead`` frames after them.

    Raises:
        ValueError: there is none.
    """
    after = max(ahead, *train.stencil)
    ranges = [np.arange(start, stop - after) for start, stop in train.clips]
    frames = np.concatenate([np.arange(0), *ranges])
    if not len(frames):
        raise ValueError(f"no training clip has {after + 1} frames; use a longer recording")
    return frames


def iterate(
    advance: Callable[[States, np.ndarray], States],
    *,
    lift: Callable[[States], States] = np.asarray,
    lower: Callable[[np.ndarray], np.ndarray] = np.asarray,
) -> Integrate:
    """Roll out a map from the state, its velocity and the inputs of a frame to the next frame's.

    The map may act on what ``lift`` makes of state and velocity, from which ``lower`` reads them again.
    """

    def integrate(q0: np.ndarray, v0: np.ndarray, inputs: np.ndarray, steps_s: Any) -> np.ndarray:
        del steps_s  # the law advances by one frame a step
        states = [lift(np.hstack([q0, v0]))]
        for number in range(inputs.shape[1] - 1):
            with np.errstate(over="ignore", invalid="ignore"):  # a law that grows is counted as diverged
                states.append(advance(states[-1], inputs[:, number]))
        return lower(np.stack(states, axis=1))[..., : q0.shape[1]]

    return integrate


def list_pairs(
    train: EvaluationSeries, frames: Int64[np.ndarray, " k"]
) -> tuple[States, States, Float64[np.ndarray, "B n_f"]]:
    """States with velocities at the frames, one frame later, and the inputs at the frames."""
    now, after = (np.hstack(initial_states(train, at)) for at in (frames, frames + 1))
    return now, after, train.forcing[frames]


def fit_linear_law(train: EvaluationSeries) -> Integrate:
    """Least squares for the next state and velocity, linear in both and in the inputs, with a constant.

    Source: dynamic mode decomposition with control, DOI 10.1137/15M1013857.
    """
    now, after, inputs = list_pairs(train, select_frames(train, ahead=1 + max(0, *train.stencil)))
    law = np.linalg.lstsq(np.hstack([now, inputs, np.ones((len(now), 1))]), after)[0]
    return iterate(lambda state, driven: np.hstack([state, driven, np.ones((len(state), 1))]) @ law)


def fit_koopman_law(train: EvaluationSeries, *, horizon: int) -> Integrate:
    """A linear law of monomials of state and velocity, driven linearly by the inputs.

    The degree of the monomials is the one whose law, fitted without the last fifth of the training frames,
    forecasts the training part best over ``horizon`` frames, or half a clip.

    Source: extended dynamic mode decomposition with control, DOI 10.1016/j.automatica.2018.03.046.
    """
    frames = select_frames(train, ahead=1 + max(0, *train.stencil))
    early = frames[: max(1, round((1 - KEPT_BACK) * len(frames)))]
    horizon = min(horizon, max(stop - start for start, stop in train.clips) // 2)
    starts = select_frames(train, ahead=horizon)
    starts = starts[choose_evenly(len(starts), COMPARED)]

    def measure_error(degree: int) -> float:
        path = roll_out(train, _fit_lifted(train, early, degree), starts, horizon + 1)
        missed = path - train.encoded[starts[:, None] + np.arange(horizon + 1)]
        with np.errstate(over="ignore", invalid="ignore"):
            error = float(squared_norm(missed, train.metric).mean())
        return error if np.isfinite(error) else np.inf

    return _fit_lifted(train, frames, min(DEGREES, key=measure_error))


def _measure_scale(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Mean and standard deviation of each column; one where a column does not vary."""
    spread = values.std(axis=0)
    return values.mean(axis=0), np.where(spread > 0, spread, 1.0)


def _fit_lifted(train: EvaluationSeries, frames: Int64[np.ndarray, " k"], degree: int) -> Integrate:
    now, after, inputs = list_pairs(train, frames)
    center, spread = _measure_scale(now)
    powers = list_powers(now.shape[1], lowest=0, highest=degree)

    def lift(state: States) -> Float64[np.ndarray, "B k"]:
        return np.prod(((state - center) / spread)[:, None] ** powers, axis=2)

    law = np.linalg.lstsq(np.hstack([lift(now), inputs]), lift(after))[0]
    linear = slice(1, 1 + now.shape[1])  # after the constant come the coordinates themselves

    return iterate(
        lambda lifted, driven: np.hstack([lifted, driven]) @ law,
        lift=lift,
        lower=lambda states: states[..., linear] * spread + center,
    )


def fit_gaussian_process(train: EvaluationSeries) -> Integrate:
    """Gaussian processes for the change of state and velocity over a frame, rolled out by their means.

    Squared-exponential kernels with a length for each variable and the noise's level by maximum likelihood.

    Source: the model of PILCO, Deisenroth and Rasmussen 2011.
    """
    from sklearn.gaussian_process import GaussianProcessRegressor, kernels  # a second to import

    frames = select_frames(train, ahead=1 + max(0, *train.stencil))
    now, after, inputs = list_pairs(train, frames[choose_evenly(len(frames), MOST_POINTS)])
    known = np.hstack([now, inputs])
    center, spread = _measure_scale(known)
    smooth = kernels.ConstantKernel() * kernels.RBF(np.ones(known.shape[1]), (0.1, 1e3))
    kernel = smooth + kernels.WhiteKernel(1e-2, (1e-8, 1e1))
    with warnings.catch_warnings():
        warnings.simplefilter("ignore")  # a length or a noise at its bound is as good as any beyond it
        laws = [
            GaussianProcessRegressor(kernel, normalize_y=True).fit((known - center) / spread, change)
            for change in (after - now).T
        ]

    def advance(state: States, driven: np.ndarray) -> States:
        at = (np.hstack([state, driven]) - center) / spread
        bounded = np.clip(np.nan_to_num(at), -1e6, 1e6)
        return state + np.stack([law.predict(bounded) for law in laws], axis=1)

    return iterate(advance)
