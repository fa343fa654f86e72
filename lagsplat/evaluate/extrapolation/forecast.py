"""Score predictions past the training frames: image PSNR, oscillation, and the amplitude that remains.

PSNR is given frame by frame and with the phase error removed. A model enters as a `Predictor`; laws
of motion in the chart share `make_law_predictor`.
"""

import time
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from jaxtyping import Float64
from scipy.interpolate import CubicSpline
from scipy.optimize import least_squares

from lagsplat.baselines.neural_ode import LatentOde, roll_out_ode
from lagsplat.evaluate.config import ExtrapolationConfig
from lagsplat.evaluate.extrapolation.oscillation import (
    compare_oscillations,
    fit_oscillation,
    measure_amplitude,
)
from lagsplat.evaluate.extrapolation.scene import BoundaryClip, Scene, StateReading, summarize_readings
from lagsplat.evaluate.forecast import image_errors
from lagsplat.evaluate.guarantee import measure_energy, measure_guarantee
from lagsplat.evaluate.latent_regression import fit_linear_law
from lagsplat.evaluate.protocol import list_series
from lagsplat.evaluate.spectrum import resample_evenly
from lagsplat.stage2.equilibrium import NoEquilibriumError, find_equilibrium
from lagsplat.stage2.numpy_lagrangian import NumpyLagrangian, roll_out_free

SCHEMA = 1
LEAST_LOOK = 16  # fewest frames of an interval that is measured
LEAST_ERROR = 1e-10
CHECKED = 200  # frames of a law's states that are rendered to check that they are in range

Draw = Callable[[np.ndarray], np.ndarray]
"""Instants in frames since the last training frame (N,), fractions allowed -> images (N,3,H,W) in [0, 1]."""
RollOut = Callable[[np.ndarray, np.ndarray, int], np.ndarray]
"""(q0 (B,d), v0 (B,d) per second, states) -> q (B,N,d), one state per median frame spacing."""


@dataclass(frozen=True)
class Predictor:
    """A model that was given the training frames of a clip.

    Instants are counted in median frame spacings from the last training frame; the first held-out one is 1.
    ``filmed`` are the states at all frames of the clip: the model's fit over the training part, then its
    prediction. ``states`` gives the states from one instant to before another, and readings of the images
    that are to be checked for their range. ``between_frames`` says whether ``draw`` takes fractions.
    """

    filmed: Float64[np.ndarray, "T d"]
    draw: Draw
    states: Callable[[int, int], tuple[np.ndarray, list[StateReading]]]
    between_frames: bool = True


def score_extrapolation(predictor: Predictor, scene: Scene) -> dict[str, Any]:
    """Everything that is compared between models, as plain data.

    ``psnr`` and ``aligned`` are of the held-out frames, ``floor`` is the PSNR of the autoencoder on them.
    ``physics`` compares the oscillation over the whole clip with the encoded one, ``held_out`` over its
    held-out end alone. ``left`` is the amplitude at the horizon over that of the clip's first period, and
    ``looks`` the measurements on the way, each with its energy by the learned law. ``range`` says how many
    predicted frames are in range; where too few are, physics and ``left`` are None and ``reason`` says so.

    Raises:
        ValueError: predicted frames of another size than the encoder's.

    Source: paper, Table "Extrapolation past the training window".
    """
    begin = time.perf_counter()
    clip, config = scene.clip, scene.config
    recorded, ahead = scene.pictures(np.arange(clip.boundary, clip.stop)), clip.ahead
    floor = scene.render(clip.latents[clip.n_train :])
    looks: list[dict[str, Any]] = []
    readings: list[StateReading] = []
    for first, stop in choose_looks(clip, config):
        states, read = predictor.states(first, stop)
        looks.append(_measure_look(scene, first, states))
        readings += read
    in_range = summarize_readings(readings)
    start = measure_amplitude(clip.latents[: clip.history(1.0) + 1], clip.metric)
    result = {
        "schema": SCHEMA,
        "recording": {
            "frames": len(clip.latents),
            "held_out": len(recorded),
            "dt_s": clip.dt_s,
            "period_s": clip.period_s,
        },
        "psnr": score_held_out_psnr(predictor.draw, recorded, ahead),
        "aligned": score_aligned_psnr(predictor.draw, recorded, ahead, shifts=_shifts(predictor, config)),
        "floor": score_held_out_psnr(lambda _: floor, recorded, ahead),
        "physics": _compare_motion(clip, predictor.filmed, first=0),
        "held_out": _compare_motion(clip, predictor.filmed, first=clip.n_train),
        "start_amplitude": start,
        "left": _share(looks[-1]["amplitude"], start),
        "left_shown": _share(looks[0]["late_amplitude"], start),
        "diverged": not all(np.isfinite(look["states"]).all() for look in looks),
        "range": in_range,
        "reason": "",
        "filmed": predictor.filmed.tolist(),
        "looks": looks,
        "wall_time_s": time.perf_counter() - begin,
    }
    if not result["diverged"] and in_range["inside"] < config.least_inside:
        reason = (
            f"only {in_range['inside']:.0%} of {in_range['frames']} predicted frames are of the kind the "
            f"encoder knows (extrapolation.least_inside={config.least_inside}): no physics is read off them"
        )
        nothing = {"predicted": None, **compare_oscillations(None, None), "reason": reason}
        unknown = {"left": None, "left_shown": None, "reason": reason}
        result |= {"physics": nothing, "held_out": nothing, **unknown}
    return result


def choose_looks(clip: BoundaryClip, config: ExtrapolationConfig) -> list[tuple[int, int]]:
    """Half-open ranges of frames past the last training frame: the first part, then the later intervals."""
    last = round(config.horizon_s / clip.dt_s)
    shown = round(config.shown_s / clip.dt_s)
    length = max(round(config.look_periods * clip.period_s / clip.dt_s), LEAST_LOOK)
    ends = np.geomspace(max(shown, 1), max(last, shown, 1), config.looks + 1)[1:]
    later = [(max(int(end) - length, shown), int(end)) for end in ends.round()]
    return [(0, shown), *[(first, stop) for first, stop in later if stop - first >= LEAST_LOOK]]


def _measure_look(scene: Scene, first: int, states: np.ndarray) -> dict[str, Any]:
    clip = scene.clip
    two_periods = max(round(clip.period_s / clip.dt_s * 2), 8)
    finite = bool(np.isfinite(states).all())
    return {
        "first": first,
        "time_s": first * clip.dt_s,
        "states": states.tolist(),
        "amplitude": measure_amplitude(states, clip.metric),
        "late_amplitude": measure_amplitude(states[-two_periods:], clip.metric),
        "mean": states.mean(axis=0).tolist(),
        "energy": measure_energy(scene.lagrangian, states, clip.dt_s).tolist() if finite else None,
    }


def _compare_motion(clip: BoundaryClip, filmed: np.ndarray, *, first: int) -> dict[str, Any]:
    """The oscillation from a frame of the clip on, against the encoded one."""
    encoded, predicted = (
        fit_oscillation(
            resample_evenly(series[first:], clip.clock, start=first), dt_s=clip.dt_s, metric=clip.metric
        )
        for series in (clip.latents, filmed)
    )
    return {"encoded": encoded, "predicted": predicted, **compare_oscillations(encoded, predicted)}


def _shifts(predictor: Predictor, config: ExtrapolationConfig) -> np.ndarray:
    if predictor.between_frames:
        return np.linspace(-config.shift_frames, config.shift_frames, config.shift_steps)
    whole = int(config.shift_frames)
    return np.arange(-whole, whole + 1, dtype=np.float64)


def _share(value: float, of: float) -> float | None:
    return float(value / of) if np.isfinite(value) and of > 0 else None


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
    """PSNR of each recorded frame against the best prediction within the ``shifts`` [frames].

    This removes the error of a model that is only ahead or behind; what remains is rendering error.
    ``shift`` lists the chosen shifts, so that a growing lag is visible. The others as `score_held_out_psnr`.
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


def extrapolate_ode(scene: Scene, ode: LatentOde) -> dict[str, Any]:
    """The measures of `score_extrapolation` for a neural ODE on the chart of the run."""

    def roll_out(q0: np.ndarray, v0: np.ndarray, states: int) -> np.ndarray:
        undriven = np.tile(ode.input_mean.numpy(), (len(q0), states, 1))
        return roll_out_ode(ode, q0, v0, undriven, scene.clip.dt_s)

    return score_extrapolation(make_law_predictor(scene, roll_out), scene)


def extrapolate_trivially(scene: Scene) -> dict[str, dict[str, Any]]:
    """The measures of `score_extrapolation` for laws without training or with one least-squares fit.

    ``mean`` is the mean training state, ``hold`` the state at the start, ``linear`` the law of
    `lagsplat.evaluate.latent_regression.fit_linear_law`.
    """
    chart = scene.chart
    mean, linear = chart.train.latents.mean(axis=0), fit_linear_law(list_series(chart, chart.train))
    undriven = chart.train.inputs.mean(axis=0)

    def follow(q0: np.ndarray, v0: np.ndarray, states: int) -> np.ndarray:
        return linear(q0, v0, np.tile(undriven, (len(q0), states, 1)), scene.clip.dt_s)

    laws: dict[str, RollOut] = {
        "mean": lambda q0, v0, states: np.tile(mean, (len(q0), states, 1)),
        "hold": lambda q0, v0, states: np.repeat(q0[:, None], states, axis=1),
        "linear": follow,
    }
    return {name: score_extrapolation(make_law_predictor(scene, law), scene) for name, law in laws.items()}


def extrapolate_run(scene: Scene) -> dict[str, Any]:
    """The measures of `score_extrapolation` for a run, its ``guarantee``, and its ``equilibrium`` or None.

    Raises:
        ValueError: the mass is induced by the decoder.
    """
    lagrangian = scene.lagrangian
    law = NumpyLagrangian(lagrangian)

    def roll_out(q0: np.ndarray, v0: np.ndarray, states: int) -> np.ndarray:
        return roll_out_free(law, q0, v0, states=states, dt_s=scene.clip.dt_s)[0]

    try:
        equilibrium = find_equilibrium(lagrangian).tolist()
    except NoEquilibriumError:
        equilibrium = None
    return score_extrapolation(make_law_predictor(scene, roll_out), scene) | {
        "clip": scene.clip.latents.tolist(),
        "equilibrium": equilibrium,
        "guarantee": measure_guarantee(lagrangian, scene.chart, scene.config.guarantee),
    }


def make_law_predictor(scene: Scene, roll_out: RollOut) -> Predictor:
    """A law of motion in the chart, rendered by the decoder of the run.

    The law is started twice, at the beginning of the clip and at the end of its training frames. Each initial
    state is the least-squares fit to the encoded training frames of ``config.history_periods``; no held-out
    frame is used. States between the law's steps are interpolated by a cubic spline. Some states are rendered
    and encoded again to check that they are in range.
    """
    clip, config = scene.clip, scene.config
    history, places = clip.history(config.history_periods), clip.places
    late_at = clip.n_train - history
    early = fit_start(roll_out, clip, at=0, frames=history)
    past = roll_out(*early, int(np.ceil(places[-1])) + 2)[0]
    late = fit_start(roll_out, clip, at=late_at, frames=history)
    lead = places[clip.n_train - 1] - places[late_at]
    steps = round(config.horizon_s / clip.dt_s) + int(np.ceil(config.shift_frames)) + 2
    path = roll_out(*late, steps + int(np.ceil(lead)))[0]
    whole = float(lead).is_integer()
    path = path[round(lead) :] if whole else _spline(path)(np.arange(lead, len(path) - 1))

    def draw(ahead: np.ndarray) -> np.ndarray:
        last = min(len(path), int(np.ceil(ahead.max())) + 4)
        return scene.render(_spline(path[:last])(np.maximum(ahead, 0.0)))

    def states(first: int, stop: int) -> tuple[np.ndarray, list[StateReading]]:
        part = path[first:stop]
        if not np.isfinite(part).all():
            return part, []
        return part, [scene.read(scene.render(part[:: max(1, len(part) // CHECKED)]))]

    return Predictor(_at(past, places), draw, states)


def fit_start(
    roll_out: RollOut, clip: BoundaryClip, *, at: int, frames: int
) -> tuple[Float64[np.ndarray, "1 d"], Float64[np.ndarray, "1 d"]]:
    """State and velocity [1/s] at frame ``at`` of the clip whose rollout fits the next ``frames`` best.

    Least squares in the metric, from the first state and the slope of a parabola through the frames.
    """
    latents, d = clip.latents[at : at + frames], clip.latents.shape[1]
    places = clip.places[at : at + frames] - clip.places[at]
    states = int(np.ceil(places[-1])) + 2
    values, vectors = np.linalg.eigh(clip.metric)
    root = vectors * np.sqrt(np.clip(values, 1e-3 * values.max(), None))
    unit = clip.period_s / (2 * np.pi)

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
    guess = np.concatenate([latents[0], slope / clip.dt_s * unit])
    best = least_squares(lambda start: residuals(start[None])[0], guess, jac=slopes, max_nfev=50).x
    return best[None, :d], best[None, d:] / unit


def _at(path: np.ndarray, places: np.ndarray) -> np.ndarray:
    """States at ``places``, in steps; exact where a place is a whole step."""
    if np.allclose(places, np.round(places), atol=1e-6):
        return path[np.round(places).astype(int)]
    return _spline(path)(places)


def _spline(path: np.ndarray) -> CubicSpline:
    return CubicSpline(np.arange(len(path)), np.nan_to_num(path))
