"""Score predictions past the training frames: image PSNR, oscillation, and the amplitude that remains.

PSNR is given frame by frame and with the phase error removed. A model enters as a `Predictor`; the learned
Lagrangian and the neural ODE share `LawPredictor`.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, Protocol, runtime_checkable

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from lagsplat.baselines.neural_ode import NeuralOde, continue_rollout
from lagsplat.chart.chart import Chart
from lagsplat.evaluate.config import ExtrapolationConfig
from lagsplat.evaluate.evaluate import make_renderer, read_recorded_inputs, require_same_run
from lagsplat.evaluate.extrapolation.oscillation import (
    KnownStates,
    StateReading,
    collect_known_states,
    compare_oscillations,
    fit_oscillation,
    measure_amplitude,
    read_states,
    summarize_reading,
)
from lagsplat.evaluate.forces.known_forces import energy_along_rollout
from lagsplat.evaluate.forecast import BoundaryClip, choose_boundary_clip, image_errors
from lagsplat.evaluate.guarantee import measure_guarantee
from lagsplat.evaluate.protocol import Pictures, Render
from lagsplat.evaluate.spectrum import resample_evenly
from lagsplat.io.recording.recording import Recording
from lagsplat.stage1.autoencoder import Autoencoder, decode_latents
from lagsplat.stage2.lagrangian import Lagrangian, find_equilibrium
from lagsplat.stage2.numpy_lagrangian import NumpyLagrangian, roll_out_free

SCHEMA = 1


def open_scene(
    autoencoder: Autoencoder, chart: Chart, recording: Recording
) -> tuple[BoundaryClip, KnownStates, Pictures]:
    """The clip to extrapolate, the states that the encoder knows, and the recorded images by frame number.

    Raises:
        ValueError: recording, chart and autoencoder do not belong together, or as `choose_boundary_clip`.
    """
    require_same_run(autoencoder, chart, recording)
    pictures = read_recorded_inputs(recording, first=0)
    return choose_boundary_clip(chart), collect_known_states(autoencoder, chart, pictures), pictures


@runtime_checkable
class Predictor(Protocol):
    """A model that was given the training frames of a clip.

    Instants are counted in median frame spacings from the last training frame; the first held-out one is 1.
    """

    @property
    def between_frames(self) -> bool:
        """Whether the model can render at fractions of a frame."""
        ...

    def filmed(self) -> Float64[np.ndarray, "T d"]:
        """States at all frames of the clip: the model's fit over the training part, then its prediction."""
        ...

    def draw(self, ahead: np.ndarray) -> np.ndarray:
        """Images in [0, 1] at these instants."""
        ...

    def states(self, first: int, stop: int) -> tuple[Float64[np.ndarray, "N d"], StateReading | None]:
        """States at the instants ``first`` to ``stop``, and how they were read from images, if they were.

        A reading of None means that the images are left out of the range check, not that they failed it.
        """
        ...


def score_extrapolation(
    predictor: Predictor,
    crossing: BoundaryClip,
    known: KnownStates,
    pictures: Pictures,
    config: ExtrapolationConfig,
    lagrangian: Lagrangian,
) -> dict[str, Any]:
    """Everything that is compared between models, as plain data.

    ``psnr`` and ``aligned`` are of the held-out frames, ``floor`` is the PSNR of the autoencoder on them.
    ``physics`` compares the oscillation over the whole clip with the encoded one, ``held_out`` over its
    held-out end alone. ``left`` is the amplitude at the horizon over that of the clip's first period, and
    ``looks`` the measurements on the way, each with its energy. ``range`` says how many predicted frames are
    in range; where too few are, physics and ``left`` are None and ``reason`` says so.

    Args:
        predictor, lagrangian: the model, and the learned law by whose energy all models are measured.
        crossing: the clip that runs from training into held-out frames.
        known, pictures: training states of the encoder, and recorded images by frame number.
        config: horizon, intervals and range limits.

    Raises:
        ValueError: predicted frames of another size than the encoder's.

    Source: paper, Table "Extrapolation past the training window".
    """
    begin = time.perf_counter()
    held = np.arange(crossing.boundary, crossing.stop)
    recorded, ahead = pictures(held), crossing.ahead
    floor = decode_latents(known.autoencoder, known.chart.to_raw(crossing.latents[crossing.n_train :]))
    energy = energy_along_rollout(lagrangian)
    looks = [_look(predictor, crossing, ends, energy) for ends in measure_states(crossing, config)]
    readings = [reading for _, reading in looks if reading is not None]
    seen = summarize_reading(readings) if readings else {"frames": 0, "inside": 0.0}
    filmed = predictor.filmed()
    start = measure_amplitude(crossing.latents[: crossing.history(1.0) + 1], crossing.metric)
    shifts = _shifts(predictor, config)
    result = {
        "schema": SCHEMA,
        "recording": {
            "frames": len(crossing.latents),
            "held_out": len(held),
            "dt_s": crossing.dt_s,
            "period_s": crossing.period_s,
        },
        "psnr": score_held_out_psnr(predictor.draw, recorded, ahead),
        "aligned": score_aligned_psnr(predictor.draw, recorded, ahead, shifts=shifts),
        "floor": score_held_out_psnr(lambda _: floor, recorded, ahead),
        **_physics(crossing, filmed),
        "start_amplitude": start,
        "left": _share(looks[-1][0]["amplitude"], start),
        "left_shown": _share(looks[0][0]["late_amplitude"], start),
        "diverged": not all(np.isfinite(look["states"]).all() for look, _ in looks),
        "range": seen,
        "reason": "",
        "filmed": filmed.tolist(),
        "looks": [look for look, _ in looks],
        "wall_time_s": time.perf_counter() - begin,
    }
    if not result["diverged"] and seen["inside"] < config.least_inside:
        result |= _unread(seen, config)
    return result


def measure_states(crossing: BoundaryClip, config: ExtrapolationConfig) -> list[tuple[int, int]]:
    """Half-open ranges of frames past the last training frame: the first part, then the later intervals."""
    last = round(config.horizon_s / crossing.dt_s)
    shown = round(config.shown_s / crossing.dt_s)
    length = max(round(config.look_periods * crossing.period_s / crossing.dt_s), 16)
    ends = np.geomspace(max(shown, 1), max(last, shown, 1), config.looks + 1)[1:]
    later = [(max(int(end) - length, shown), int(end)) for end in ends.round()]
    return [(0, shown), *[(first, stop) for first, stop in later if stop - first >= 16]]


def _look(
    predictor: Predictor,
    crossing: BoundaryClip,
    ends: tuple[int, int],
    energy: Callable[[np.ndarray, float], np.ndarray],
) -> tuple[dict[str, Any], StateReading | None]:
    states, reading = predictor.states(*ends)
    cycles = max(round(crossing.period_s / crossing.dt_s * 2), 8)
    finite = bool(np.isfinite(states).all())
    return {
        "first": ends[0],
        "time_s": ends[0] * crossing.dt_s,
        "states": states.tolist(),
        "amplitude": measure_amplitude(states, crossing.metric),
        "late_amplitude": measure_amplitude(states[-cycles:], crossing.metric),
        "mean": states.mean(axis=0).tolist(),
        "energy": energy(states, crossing.dt_s).tolist() if finite else None,
    }, reading


def _physics(crossing: BoundaryClip, filmed: np.ndarray) -> dict[str, Any]:
    """Oscillation over the whole clip and over its held-out end, each against the encoded one."""
    blocks = {}
    for name, first in (("physics", 0), ("held_out", crossing.n_train)):
        sides = []
        for series in (crossing.latents, filmed):
            even = resample_evenly(series[first:], crossing.clock, start=first)
            sides.append(fit_oscillation(even, dt_s=crossing.dt_s, metric=crossing.metric))
        blocks[name] = {"encoded": sides[0], "predicted": sides[1], **compare_oscillations(*sides)}
    return blocks


def _shifts(predictor: Predictor, config: ExtrapolationConfig) -> np.ndarray:
    if predictor.between_frames:
        return np.linspace(-config.shift_frames, config.shift_frames, config.shift_steps)
    whole = int(config.shift_frames)
    return np.arange(-whole, whole + 1, dtype=np.float64)


def _share(value: float, of: float) -> float | None:
    return float(value / of) if np.isfinite(value) and of > 0 else None


def _unread(seen: dict[str, Any], config: ExtrapolationConfig) -> dict[str, Any]:
    """The blocks, without numbers, of a forecast that leaves the chart."""
    reason = (
        f"only {seen['inside']:.0%} of {seen['frames']} predicted frames are of the kind the encoder knows "
        f"(extrapolation.least_inside={config.least_inside}): no physics is read off them"
    )
    nothing = {"predicted": None, **compare_oscillations(None, None), "reason": reason}
    return {"physics": nothing, "held_out": nothing, "left": None, "left_shown": None, "reason": reason}


Draw = Callable[[np.ndarray], np.ndarray]
"""Instants in frames since the last training frame (N,), fractions allowed -> images (N,3,H,W) in [0, 1]."""
LEAST_ERROR = 1e-10


def to_decibels(errors: Float64[np.ndarray, " N"]) -> Float64[np.ndarray, " N"]:
    """PSNR [dB] of mean squared errors of colours in [0, 1]; at most 100."""
    return -10.0 * np.log10(np.maximum(errors, LEAST_ERROR))


def score_held_out_psnr(draw: Draw, recorded: np.ndarray, ahead: np.ndarray) -> dict[str, Any]:
    """PSNR [dB] of each predicted frame against the ``recorded`` (N,3,H,W): mean, first, last and all.

    ``ahead`` are the instants of the recorded frames, in frames since the last training frame.

    Source: paper, Table "Extrapolation past the training window".
    """
    return _summary(to_decibels(image_errors(draw(ahead), recorded)))


def score_aligned_psnr(
    draw: Draw, recorded: np.ndarray, ahead: np.ndarray, *, shifts: Float64[np.ndarray, " S"]
) -> dict[str, Any]:
    """PSNR of each recorded frame against the best prediction within the ``shifts``.

    This removes the error of a model that is only ahead or behind; what remains is rendering error.
    ``shift`` lists the chosen shifts, so that a growing lag is visible.

    Args:
        draw, recorded: renders the model at instants, and recorded images (N,3,H,W).
        ahead, shifts: their instants since the last training frame, and shifts to try, in frames.
    """
    values = np.stack([to_decibels(image_errors(draw(ahead + shift), recorded)) for shift in shifts])
    best = values.argmax(axis=0)
    return {**_summary(values.max(axis=0)), "shift": shifts[best].tolist()}


def _summary(values: np.ndarray) -> dict[str, Any]:
    return {
        "mean": float(values.mean()),
        "first": float(values[0]),
        "last": float(values[-1]),
        "per_frame": values.tolist(),
    }


def extrapolate_ode(
    autoencoder: Autoencoder,
    chart: Chart,
    lagrangian: Lagrangian,
    ode: NeuralOde,
    recording: Recording,
    config: ExtrapolationConfig,
) -> dict[str, Any]:
    """The measures of `score_extrapolation` for a neural ODE on the same chart."""
    crossing, known, pictures = open_scene(autoencoder, chart, recording)

    def roll_out(q0: np.ndarray, v0: np.ndarray, states: int) -> np.ndarray:
        return continue_rollout(ode, q0, v0, states=states, dt_s=crossing.dt_s)

    predictor = make_law_predictor(roll_out, known, make_renderer(autoencoder, chart), crossing, config)
    return score_extrapolation(predictor, crossing, known, pictures, config, lagrangian)


def extrapolate_run(
    autoencoder: Autoencoder,
    chart: Chart,
    lagrangian: Lagrangian,
    recording: Recording,
    config: ExtrapolationConfig,
) -> dict[str, Any]:
    """The measures of `score_extrapolation` for a run, with its equilibrium and its ``guarantee``.

    Raises:
        ValueError: as `open_scene`, or the mass is induced by the decoder.
    """
    crossing, known, pictures = open_scene(autoencoder, chart, recording)
    roll_out, render = roll_out_free_motion(lagrangian, crossing.dt_s), make_renderer(autoencoder, chart)
    predictor = make_law_predictor(roll_out, known, render, crossing, config)
    still = lagrangian.rest.new_zeros(lagrangian.n_inputs)
    return score_extrapolation(predictor, crossing, known, pictures, config, lagrangian) | {
        "clip": crossing.latents.tolist(),
        "equilibrium": find_equilibrium(lagrangian, still).tolist(),
        "guarantee": measure_guarantee(lagrangian, chart, config.guarantee),
    }


RollOut = Callable[[np.ndarray, np.ndarray, int], np.ndarray]
"""(q0 (B,d), v0 (B,d) per second, states) -> q (B,N,d), one state per median frame spacing."""


def roll_out_free_motion(lagrangian: Lagrangian, dt_s: float) -> RollOut:
    """A function that rolls out free motion of a learned law, one state every ``dt_s`` seconds."""
    law = NumpyLagrangian(lagrangian)

    def roll_out(q0: np.ndarray, v0: np.ndarray, states: int) -> np.ndarray:
        return roll_out_free(law, q0, v0, states=states, dt_s=dt_s)[0]

    return roll_out


CHECKED = 200  # frames of a law's states that are rendered to check that they are in range


@dataclass(frozen=True)
class LawPredictor:
    """A law of motion in the chart, rendered by the decoder.

    ``path`` are its states from the last training frame on, one per median spacing; ``past`` those at the
    frames of the clip, rolled out from its beginning.
    """

    known: KnownStates
    config: ExtrapolationConfig
    render: Render
    past: Float64[np.ndarray, "T d"]
    path: Float64[np.ndarray, "N d"]
    between_frames: bool = True

    def filmed(self) -> Float64[np.ndarray, "T d"]:
        """The rollout from the beginning of the clip."""
        return self.past

    def draw(self, ahead: np.ndarray) -> np.ndarray:
        """Images of the law's states, interpolated between its steps by a cubic spline."""
        last = min(len(self.path), int(np.ceil(ahead.max())) + 4)
        steps = CubicSpline(np.arange(last), np.nan_to_num(self.path[:last]))
        return self.render(steps(np.maximum(ahead, 0.0)))

    def states(self, first: int, stop: int) -> tuple[Float64[np.ndarray, "N d"], StateReading | None]:
        """The law's states; some are rendered and encoded again to check that they are in range."""
        part = self.path[first:stop]
        if not np.isfinite(part).all():
            return part, None
        few = part[:: max(1, len(part) // CHECKED)]
        return part, read_states(self.known, self.render(few), self.config)


def make_law_predictor(
    roll_out: RollOut, known: KnownStates, render: Render, crossing: BoundaryClip, config: ExtrapolationConfig
) -> LawPredictor:
    """Start a law twice: at the beginning of the clip and at the end of its training frames.

    Each initial state is the least-squares fit to the encoded training frames of ``config.history_periods``;
    no held-out frame is used.
    """
    history = crossing.history(config.history_periods)
    places = crossing.places
    early = fit_start(roll_out, crossing, at=0, frames=history)
    whole = roll_out(*early, int(np.ceil(places[-1])) + 2)[0]
    late_at = crossing.n_train - history
    late = fit_start(roll_out, crossing, at=late_at, frames=history)
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


def fit_start(
    roll_out: RollOut, crossing: BoundaryClip, *, at: int, frames: int
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
        # a start whose rollout diverges gets a large error, so that the search goes on
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
    """States at ``places``, in steps; exact where a place is a whole step."""
    if np.allclose(places, np.round(places), atol=1e-6):
        return path[np.round(places).astype(int)]
    return CubicSpline(np.arange(len(path)), np.nan_to_num(path))(places)


def _later(path: np.ndarray, lead: float) -> np.ndarray:
    return CubicSpline(np.arange(len(path)), np.nan_to_num(path))(np.arange(lead, len(path) - 1))
