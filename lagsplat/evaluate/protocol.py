"""What all scores share: the held-out series, starts and treatment of divergence.

Series are whitened latents in float64 and inputs in their own units; frame numbers count from the start of
the held-out part.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Bool, Float64, Int64

from lagsplat.chart.chart import Chart
from lagsplat.chart.trajectory import EncodedTrajectory, TimeBase
from lagsplat.evaluate.config import EvaluateConfig

Rollouts = Float64[np.ndarray, "B N d"]
Integrate = Callable[[np.ndarray, np.ndarray, np.ndarray, float | np.ndarray], np.ndarray]
"""(q0 (B,d), v0 (B,d) per second, inputs (B,N,n_u), steps [s], a number or (B,N-1)) -> q (B,N,d); non-finite
where it diverged.
"""
Render = Callable[[np.ndarray], np.ndarray]  # q (N,d) -> images (N,3,H,W) with colours in [0, 1]
Pictures = Callable[[np.ndarray], np.ndarray]
"""held-out frame numbers (N,) -> the recorded images (N,3,H,W) with colours in [0, 1]."""
Velocities = Callable[[np.ndarray], np.ndarray]
"""held-out frame numbers (N,) -> velocities (N,d) per second, of a model that measures them itself."""

STENCILS = {"forward": (1, 2), "central": (-2, -1, 1, 2), "neighbours": (-1, 1)}


@dataclass(frozen=True)
class EvaluationSeries:
    """A part of a recording in the form that scores and laws of latents use, most often the held-out one.

    ``encoded`` and ``forcing`` are smoothed, for initial states and forcing. ``latents`` and ``inputs`` are
    as encoded and measured; forecasts are compared with these, which no frame ahead has made smoother. Scores
    begin at frame ``skip``. ``dt_s`` is the median spacing, by which horizons are counted in frames;
    ``time_s`` [s] are the instants of unevenly spaced frames, and velocities and rollouts use these.
    ``stencil`` are the frames, counted from a start, whose states give
    the initial velocity together with the start's own, unless the model measures ``velocities`` itself.
    Where ``forcing`` holds more than this frame's inputs, ``standing`` is its value had the inputs always
    been constant.
    """

    encoded: Float64[np.ndarray, "T d"]
    latents: Float64[np.ndarray, "T d"]
    forcing: Float64[np.ndarray, "T n_f"]
    inputs: Float64[np.ndarray, "T n_u"]
    segments: tuple[tuple[int, int], ...]
    metric: Float64[np.ndarray, "d d"]
    dt_s: float
    skip: int
    time_s: Float64[np.ndarray, " T"] | None = None
    stencil: tuple[int, ...] = STENCILS["forward"]
    velocities: Velocities | None = None
    standing: Float64[np.ndarray, "T n_f"] | None = None

    @property
    def clips(self) -> list[tuple[int, int]]:
        """First frame a rollout may start from, and end, of every clip that is scored."""
        back = max(0, -min(self.stencil))
        scored = ((max(start + back, self.skip), stop) for start, stop in self.segments)
        return [(start, stop) for start, stop in scored if start < stop]

    @property
    def longest(self) -> tuple[int, int]:
        """The longest of `clips`; an empty one if there is none."""
        return max(self.clips, key=lambda clip: clip[1] - clip[0], default=(0, 0))

    @property
    def clock(self) -> TimeBase:
        """The time base of the frames."""
        return TimeBase(self.dt_s, self.time_s)

    @property
    def n_frames(self) -> int:
        """Number of frames, including skipped ones."""
        return self.encoded.shape[0]

    @property
    def reach(self) -> float:
        """Length of the longest encoded state, in whitened units."""
        return float(np.linalg.norm(self.encoded, axis=1).max())


@dataclass(frozen=True)
class EvaluationSubject:
    """A model and the held-out part of a recording: what the scores take.

    ``dynamics`` names the kind of its law; ``external_force`` says where a force given in the image can act.
    """

    d: int
    dynamics: str
    external_force: str
    held: EvaluationSeries
    pictures: Pictures
    render: Render
    integrate: Integrate


def select_held_out(chart: Chart, config: EvaluateConfig) -> EvaluationSeries:
    """The held-out part of a chart, smoothed once for every score with the chart's smoothing.

    Raises:
        ValueError: no frame remains after ``evaluate.skip_s``.
    """
    part = chart.held_out
    skip = round(config.skip_s / chart.dt_s)
    if skip + 3 > len(part.latents):
        raise ValueError(
            f"the held-out part has {len(part.latents)} frames and evaluate.skip_s={config.skip_s} takes "
            f"{skip} of them; lower evaluate.skip_s or hold out a longer part"
        )
    return list_series(chart, part, skip=skip, velocity=config.velocity)


def list_series(
    chart: Chart, part: EncodedTrajectory, *, skip: int = 0, velocity: str = "central"
) -> EvaluationSeries:
    """The ``part`` of a chart in the form that the scores use, from frame ``skip`` on.

    ``velocity`` names the stencil of initial velocities, one of `STENCILS`.
    """
    smooth = part.smoothed(chart.smoothing_frames)
    return EvaluationSeries(
        encoded=smooth.latents,
        latents=part.latents,
        forcing=smooth.inputs,
        inputs=part.inputs,
        segments=part.segments,
        metric=chart.metric,
        dt_s=chart.dt_s,
        skip=skip,
        time_s=None if chart.whole.clock.time_s is None else part.time_s,
        stencil=STENCILS[velocity],
    )


def explain_shortage(held: EvaluationSeries, *, length: int, margin: int) -> str:
    """Why no rollout of ``length`` states fits into a scored clip; empty where one does."""
    span = max(length + margin, 3)
    start, stop = held.longest
    if stop - start > span:
        return ""
    return (
        f"a forecast of {length} frames needs a held-out clip of more than {span} frames after the skip of "
        f"{held.skip}, the longest has {stop - start}; shorten the horizon, lower evaluate.skip_s or hold "
        "out more"
    )


def draw_starts(
    held: EvaluationSeries, *, length: int, margin: int, count: int, seed: int
) -> Int64[np.ndarray, " B"]:
    """Random start frames whose ``length`` states and velocity stencil stay within one clip, none twice.

    On a single clip these are ``default_rng(seed).integers(skip, T - length - margin, size=count)``, with
    others for repeated ones; fewer than ``count`` where there are fewer. Windows may overlap, see
    `lagsplat.evaluate.aggregate.group_windows`; ``margin`` frames are needed after each.

    Raises:
        ValueError: no clip of the scored part is long enough.
    """
    span = max(length + margin, 3)
    if why := explain_shortage(held, length=length, margin=margin):
        raise ValueError(why)
    valid = np.concatenate([np.arange(start, stop - span) for start, stop in held.clips])
    rng = np.random.default_rng(seed)
    draws = [*rng.integers(0, valid.size, size=count), *rng.permutation(valid.size)]
    return valid[list(dict.fromkeys(draws))[:count]].astype(np.int64)


def initial_states(
    held: EvaluationSeries, starts: Int64[np.ndarray, " B"]
) -> tuple[Float64[np.ndarray, "B d"], Float64[np.ndarray, "B d"]]:
    """Encoded states and velocities [whitened units per second] at the start frames.

    The velocity is the second-order difference over the stencil, on true times, or the model's own.
    """
    if held.velocities is not None:
        return held.encoded[starts], held.velocities(starts)
    return held.encoded[starts], held.clock.slope(held.encoded, starts, held.stencil)


def cut_windows(
    series: Float64[np.ndarray, "T m"], starts: Int64[np.ndarray, " B"], length: int
) -> np.ndarray:
    """The windows of ``length`` frames that begin at ``starts``, shape (B, length, m)."""
    return series[starts[:, None] + np.arange(length)]


def roll_out(
    held: EvaluationSeries, integrate: Integrate, starts: Int64[np.ndarray, " B"], states: int
) -> Rollouts:
    """Rollouts of so many ``states`` from the encoded states at the starts, under the recorded inputs."""
    q0, v0 = initial_states(held, starts)
    return integrate(q0, v0, cut_windows(held.forcing, starts, states), held.clock.steps_s(starts, states))


def has_diverged(states: Float64[np.ndarray, "*N d"], bound: float) -> Bool[np.ndarray, "*N"]:
    """Which states are not finite or longer than ``bound``."""
    # Squares of a diverging rollout overflow long before the rollout itself does.
    tame = np.clip(np.nan_to_num(states, nan=np.inf), -1e100, 1e100)
    return np.linalg.norm(tame, axis=-1) > bound


def pin_diverged(rollouts: Rollouts, *, bound: float) -> tuple[Rollouts, Bool[np.ndarray, "B N"]]:
    """Pin every state from the first divergence on to the bound; also returns where that happened.

    A state has diverged when it is not finite or longer than ``bound``; so has every later state of its
    rollout. Pinned states lie at length ``bound`` in the direction of the last finite state, so that they
    can be rendered and compared. Scores take the larger of a pinned state's error and the error of the mean
    prediction, so that divergence is never rewarded.
    """
    gone = np.logical_or.accumulate(has_diverged(rollouts, bound), axis=1)
    pinned = rollouts.copy()
    for row in np.flatnonzero(gone[:, -1]):
        first = int(np.argmax(gone[row]))
        last = first if np.isfinite(rollouts[row, first]).all() else max(first - 1, 0)
        direction = np.nan_to_num(rollouts[row, last], nan=1.0, posinf=1.0, neginf=-1.0)
        direction = direction / max(np.abs(direction).max(), 1e-300)
        pinned[row, first:] = bound * direction / max(np.linalg.norm(direction), 1e-300)
    return pinned, gone


def squared_norm(vectors: np.ndarray, metric: np.ndarray) -> np.ndarray:
    """Squared length of the vectors on the last axis, ``v^T G v``."""
    return np.einsum("...i,ij,...j->...", vectors, metric, vectors)
