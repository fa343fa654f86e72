"""What the measures of extrapolation ask of a model, and how a law of motion answers."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from lagsplat.evaluate.crossing import Crossing
from lagsplat.evaluate.extrapolation_config import ExtrapolationConfig
from lagsplat.evaluate.in_range import Known, Reading, read
from lagsplat.evaluate.protocol import Render

RollOut = Callable[[np.ndarray, np.ndarray, int], np.ndarray]
"""(q0 (B,d), v0 (B,d) per second, states) -> q (B,N,d), one state a median spacing of frames."""
CHECKED = 200  # frames drawn of a law's own states, to see that they are in range


@runtime_checkable
class Predictor(Protocol):
    """A model that was given the training frames of a clip.

    Instants are counted in median spacings of frames since the last training frame: 1 is the first one held
    out.
    """

    @property
    def between_frames(self) -> bool:
        """Whether it can draw at fractions of a frame."""
        ...

    def filmed(self) -> Float64[np.ndarray, "T d"]:
        """States at all frames of the clip: over the training part what the model makes of it, then its
        prediction."""
        ...

    def draw(self, ahead: np.ndarray) -> np.ndarray:
        """Images in [0, 1] at these instants."""
        ...

    def states(self, first: int, stop: int) -> tuple[Float64[np.ndarray, "N d"], Reading | None]:
        """States at the instants ``first`` to ``stop``, and how they were read off pictures, if they were.

        None of a reading means that the pictures are left out of the check, not that they failed it.
        """
        ...


@dataclass(frozen=True)
class LawPredictor:
    """A law of motion in the chart, drawn by the decoder.

    ``path`` are its states from the last training frame on, one a median spacing; ``past`` those at the
    frames of the clip, rolled out from its beginning.
    """

    known: Known
    config: ExtrapolationConfig
    render: Render
    past: Float64[np.ndarray, "T d"]
    path: Float64[np.ndarray, "N d"]
    between_frames: bool = True

    def filmed(self) -> Float64[np.ndarray, "T d"]:
        """The rollout from the beginning of the clip."""
        return self.past

    def draw(self, ahead: np.ndarray) -> np.ndarray:
        """Pictures of the law's states, between its steps by a cubic spline."""
        last = min(len(self.path), int(np.ceil(ahead.max())) + 4)
        steps = CubicSpline(np.arange(last), np.nan_to_num(self.path[:last]))
        return self.render(steps(np.maximum(ahead, 0.0)))

    def states(self, first: int, stop: int) -> tuple[Float64[np.ndarray, "N d"], Reading | None]:
        """The law's own states; some of their pictures are read back to see whether they are in range."""
        part = self.path[first:stop]
        if not np.isfinite(part).all():
            return part, None
        few = part[:: max(1, len(part) // CHECKED)]
        return part, read(self.known, self.render(few), self.config)


def law_predictor(
    roll_out: RollOut, known: Known, render: Render, crossing: Crossing, config: ExtrapolationConfig
) -> LawPredictor:
    """A law started twice: at the beginning of the clip, and where the training frames end.

    Both states are those whose rollout fits the encoded training frames of ``config.history_periods`` best;
    no held-out frame is used.
    """
    history = crossing.history(config.history_periods)
    places = crossing.places
    early = fitted_start(roll_out, crossing, at=0, frames=history)
    whole = roll_out(*early, int(np.ceil(places[-1])) + 2)[0]
    late_at = crossing.n_train - history
    late = fitted_start(roll_out, crossing, at=late_at, frames=history)
    lead = places[crossing.n_train - 1] - places[late_at]
    steps = round(config.horizon_s / crossing.dt_s) + int(np.ceil(config.shift_frames)) + 2
    path = roll_out(*late, steps + int(np.ceil(lead)))[0]
    return LawPredictor(
        known=known,
        config=config,
        render=render,
        past=_at(whole, places),
        path=path[round(lead) :] if float(lead).is_integer() else _later(path, lead),
    )


def fitted_start(
    roll_out: RollOut, crossing: Crossing, *, at: int, frames: int
) -> tuple[Float64[np.ndarray, "1 d"], Float64[np.ndarray, "1 d"]]:
    """State and velocity [1/s] at frame ``at`` of the clip whose rollout fits the next ``frames`` best.

    Least squares in the metric, from the first state and the slope of a parabola through the frames.
    """
    latents, d = crossing.latents[at : at + frames], crossing.latents.shape[1]
    places = crossing.places[at : at + frames] - crossing.places[at]
    states = int(np.ceil(places[-1])) + 2
    values, vectors = np.linalg.eigh(crossing.metric)
    root = vectors * np.sqrt(np.clip(values, 1e-3 * values.max(), None))
    unit = crossing.period_s / (2 * np.pi)

    def residuals(rows: np.ndarray) -> np.ndarray:
        paths = roll_out(rows[:, :d], rows[:, d:] / unit, states)
        missed = np.stack([(_at(path, places) - latents) @ root for path in paths])
        # a start that blows up must look bad, not break the search
        return np.clip(np.nan_to_num(missed, nan=1e6), -1e6, 1e6).reshape(len(rows), -1)

    def slopes(start: np.ndarray) -> np.ndarray:
        step = 1e-5
        rows = start + step * np.concatenate([np.eye(2 * d), -np.eye(2 * d)])
        ahead, behind = np.split(residuals(rows), 2)
        return (ahead - behind).T / (2 * step)

    first = min(len(latents), 5)
    slope = np.polynomial.polynomial.polyfit(places[:first], latents[:first], min(2, first - 1))[1]
    guess = np.concatenate([latents[0], slope / crossing.dt_s * unit])
    found = least_squares(lambda start: residuals(start[None])[0], guess, jac=slopes, max_nfev=50).x
    return found[None, :d], found[None, d:] / unit


def _at(path: np.ndarray, places: np.ndarray) -> np.ndarray:
    """States at ``places``, in steps; the path's own where these are whole."""
    if np.allclose(places, np.round(places), atol=1e-6):
        return path[np.round(places).astype(int)]
    return CubicSpline(np.arange(len(path)), np.nan_to_num(path))(places)


def _later(path: np.ndarray, lead: float) -> np.ndarray:
    return CubicSpline(np.arange(len(path)), np.nan_to_num(path))(np.arange(lead, len(path) - 1))
