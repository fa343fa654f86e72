"""What a model predicts past its training frames: pictures, oscillation, and what is left of it."""

import time
from collections.abc import Callable
from typing import Any

import numpy as np

from lagsplat.chart.chart import Chart
from lagsplat.evaluate.crossing import Crossing, crossing_clip
from lagsplat.evaluate.extrapolation_config import ExtrapolationConfig
from lagsplat.evaluate.in_range import Known, Reading, known_to, told
from lagsplat.evaluate.oscillation import amplitude, compare_oscillations, oscillation
from lagsplat.evaluate.predictor import Predictor
from lagsplat.evaluate.protocol import Pictures
from lagsplat.evaluate.psnr import aligned_psnr, held_out_psnr
from lagsplat.evaluate.resample import evenly_spaced
from lagsplat.io.recording import Recording
from lagsplat.stage1.autoencoder import Autoencoder, decode_latents

SCHEMA = 1
Energy = Callable[[np.ndarray, float], np.ndarray]
"""(states (N,d), spacing [s]) -> the energy of the learned law along them (N,)."""


def recorded_frames(recording: Recording) -> Pictures:
    """Recorded images (N,3,H,W) in [0, 1] by frame number."""

    def pictures(frames: np.ndarray) -> np.ndarray:
        stored = np.asarray(recording.frames[frames])
        return np.moveaxis(stored, 3, 1).astype(np.float32) / np.float32(255.0)

    return pictures


def open_scene(
    autoencoder: Autoencoder, chart: Chart, recording: Recording
) -> tuple[Crossing, Known, Pictures]:
    """The clip that is extrapolated, what the encoder knows, and the recorded pictures.

    Raises:
        ValueError: as `crossing_clip`.
    """
    pictures = recorded_frames(recording)
    return crossing_clip(chart), known_to(autoencoder, chart, pictures), pictures


def extrapolation(
    predictor: Predictor,
    crossing: Crossing,
    known: Known,
    pictures: Pictures,
    config: ExtrapolationConfig,
    energy: Energy,
) -> dict[str, Any]:
    """Everything that is compared between models, as plain data.

    ``psnr`` and ``aligned`` are of the held-out frames, ``floor`` what the autoencoder itself makes of these.
    ``physics`` compares the oscillation over the whole clip with the encoded one, ``held_out`` over its
    held-out end alone. ``left`` is the amplitude at the horizon over that of the clip's first period, and
    ``looks`` what was seen on the way, each with its energy. ``range`` says how far the predicted frames are
    in range; where too few are, physics and ``left`` are None and ``reason`` says so.

    Raises:
        ValueError: predicted frames of another size than the encoder's.

    Source: paper, Table "Extrapolation past the training window".
    """
    begin = time.perf_counter()
    held = np.arange(crossing.boundary, crossing.stop)
    recorded, ahead = pictures(held), crossing.ahead
    floor = decode_latents(known.autoencoder, known.chart.to_raw(crossing.latents[crossing.n_train :]))
    looks = [_look(predictor, crossing, ends, energy) for ends in looked_at(crossing, config)]
    readings = [reading for _, reading in looks if reading is not None]
    seen = told(readings) if readings else {"frames": 0, "inside": 0.0}
    filmed = predictor.filmed()
    start = amplitude(crossing.latents[: crossing.history(1.0) + 1], crossing.metric)
    shifts = _shifts(predictor, config)
    result = {
        "schema": SCHEMA,
        "recording": {
            "frames": len(crossing.latents),
            "held_out": len(held),
            "dt_s": crossing.dt_s,
            "period_s": crossing.period_s,
        },
        "psnr": held_out_psnr(predictor.draw, recorded, ahead),
        "aligned": aligned_psnr(predictor.draw, recorded, ahead, shifts=shifts),
        "floor": held_out_psnr(lambda _: floor, recorded, ahead),
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


def looked_at(crossing: Crossing, config: ExtrapolationConfig) -> list[tuple[int, int]]:
    """Half-open ranges of frames past the last training frame: the shown part, then the looks."""
    last = round(config.horizon_s / crossing.dt_s)
    shown = round(config.shown_s / crossing.dt_s)
    length = max(round(config.look_periods * crossing.period_s / crossing.dt_s), 16)
    ends = np.geomspace(max(shown, 1), max(last, shown, 1), config.looks + 1)[1:]
    later = [(max(int(end) - length, shown), int(end)) for end in ends.round()]
    return [(0, shown), *[(first, stop) for first, stop in later if stop - first >= 16]]


def _look(
    predictor: Predictor, crossing: Crossing, ends: tuple[int, int], energy: Energy
) -> tuple[dict[str, Any], Reading | None]:
    states, reading = predictor.states(*ends)
    cycles = max(round(crossing.period_s / crossing.dt_s * 2), 8)
    finite = bool(np.isfinite(states).all())
    return {
        "first": ends[0],
        "time_s": ends[0] * crossing.dt_s,
        "states": states.tolist(),
        "amplitude": amplitude(states, crossing.metric),
        "late_amplitude": amplitude(states[-cycles:], crossing.metric),
        "mean": states.mean(axis=0).tolist(),
        "energy": energy(states, crossing.dt_s).tolist() if finite else None,
    }, reading


def _physics(crossing: Crossing, filmed: np.ndarray) -> dict[str, Any]:
    """Oscillation over the whole clip and over its held-out end, each against the encoded one."""
    blocks = {}
    for name, first in (("physics", 0), ("held_out", crossing.n_train)):
        sides = []
        for series in (crossing.latents, filmed):
            even = evenly_spaced(series[first:], crossing.clock, start=first)
            sides.append(oscillation(even, dt_s=crossing.dt_s, metric=crossing.metric))
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
    """The blocks that a forecast which leaves the chart has instead of numbers."""
    reason = (
        f"only {seen['inside']:.0%} of {seen['frames']} predicted frames are of the kind the encoder knows "
        f"(extrapolation.least_inside={config.least_inside}): no physics is read off them"
    )
    nothing = {"predicted": None, **compare_oscillations(None, None), "reason": reason}
    return {"physics": nothing, "held_out": nothing, "left": None, "left_shown": None, "reason": reason}
