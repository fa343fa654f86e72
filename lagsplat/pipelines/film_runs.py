"""A film as the simulator: a run is fitted to it once, kept in a cache, and is the simulator from then on."""

import json
import os
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np

from lagsplat.config.compose import compose
from lagsplat.config.schema import Config
from lagsplat.diagnose.core.config import DiagnoseConfig
from lagsplat.diagnose.core.result import Finding
from lagsplat.diagnose.imaging.video_checks import drop_unusable_frames
from lagsplat.io.files.atomic import sha256_of
from lagsplat.io.files.lease import hold_lease
from lagsplat.io.files.user_cache import locate_in_cache
from lagsplat.io.read import read_recording
from lagsplat.io.recording.inputs import add_inputs
from lagsplat.io.recording.recording import Recording, load_recording
from lagsplat.io.recording.segments import split_train_held_out
from lagsplat.io.robot_log.survey import survey_log
from lagsplat.io.sources import VIDEO_KINDS, DataSource, find_sources
from lagsplat.io.video.clips import find_clips
from lagsplat.io.video.proposal import IMAGE_MODEL, choose_frame_size, propose_settings
from lagsplat.pipelines.diagnosis_videos import HELD_OUT
from lagsplat.pipelines.real_videos import read_real_video
from lagsplat.pipelines.steps import reading_overrides
from lagsplat.provenance import code_digest, set_threads
from lagsplat.report.inspection.log import suggest_overrides
from lagsplat.runs.fit import fit_run
from lagsplat.video_quality.assessment import LEAST_FRAMES, LEVELS

FITTING_CODE = ("lagsplat.runs.fit", "lagsplat.io.video.proposal", "lagsplat.io.recording.inputs")
"""Modules that a kept run depends on, with all that they import."""
FILM_TITLE = "film"
"""The title of a system of which nothing is known but its film."""
OF_ALL_FRAMES = ("flicker", "sampling")  # findings on a film that no cut removes


def fit_film(
    sims: Sequence[DataSource],
    real: str,
    config: DiagnoseConfig,
    *,
    show_fit: Callable[[str], None] = lambda _: None,
) -> tuple[Path, tuple[Finding, ...]]:
    """Fit a run to the one film in ``sims``, or find it where that was done before.

    The run has ``config.film_d`` coordinates and the settings of ``config.film_profile``; size, cut and
    smoothing are those that `lagsplat inspect` proposes. A run is kept by the content of its film and of the
    table of its inputs, by its settings and by the code. A fit that was stopped goes on where it was, and
    processes that want the same run wait for one another. Everything that can be checked of the film and of
    what ``real`` names is checked before the fit.

    Args:
        sims: What ``sim`` names.
        real: What is compared with it, as of `open_recording_pair`.
        config: Settings of the diagnosis.
        show_fit: Called with a sentence on the run, before it is fitted.

    Returns:
        The folder of the run, and findings on it and on its film.

    Raises:
        FileNotFoundError: nothing is at ``real``.
        ValueError: several sims; a film that cannot be read, is too short or shows no motion; a real
            recording that cannot be compared with it; or the fit failed.
    """
    if len(sims) > 1:
        raise ValueError(
            f"sim names {len(sims)} files, {sims[0].path} and others; name one film, which a run is fitted to"
        )
    film = sims[0]
    experiment = _compose_settings(film, config)
    folder = _locate_run(film, experiment)
    about = _describe_run(film, folder, config)
    if _is_complete(folder):
        show_fit(f"{about.what}; it is used again")
    else:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of both films: each is a finding later
            experiment, recording = _read_film(film, experiment)
            _check_film(film, recording, experiment)
            _check_real(real, recording, experiment)
            show_fit(f"{about.what}; {about.remedy}")
            waiting = f"another process fits the run in {folder}; waiting for it"
            with hold_lease(folder, on_wait=lambda: show_fit(waiting)):
                if not _is_complete(folder):
                    _fit(film, experiment, folder, recording)
    kept = load_recording(folder / "recording.safetensors")
    of_film = [each for each in drop_unusable_frames(kept)[1] if each.check in OF_ALL_FRAMES]
    return folder, (about, *_describe_cut(kept), *of_film)


def _compose_settings(film: DataSource, config: DiagnoseConfig) -> Config:
    """The settings of the fit, as far as they do not depend on what the film shows."""
    path = Path(film.path).resolve()
    words = [f"profile={config.film_profile}", f"system.title={FILM_TITLE}"]
    if film.kind == "mcap":
        suggested = suggest_overrides(survey_log(path))
        if not suggested:
            raise ValueError(f"{path}: no topic holds pictures that can be read; name another log")
        # which numbers drive the mechanism the log does not tell
        words += [word for word in suggested if not word.startswith("recording.mcap.inputs=")]
    else:
        words += reading_overrides(path)
    if film.kind in ("video", "mcap"):
        words += ["system.film_kind=video", "evaluate=default"]
        words += [f"system.{key}={value}" for key, value in IMAGE_MODEL.items()]
    experiment = compose(*words, f"system.d={config.film_d}")
    # the base system is an arm of the public archive
    recording = replace(experiment.recording, archive=None, member=None)
    return replace(experiment, recording=recording, simulation=None)


def _locate_run(film: DataSource, experiment: Config) -> Path:
    """The folder of a run, named by all that determines it."""
    files = [file for clip in find_clips(film.path) for file in clip.files]
    files += [Path(film.inputs)] if film.inputs else []
    contents = [sha256_of(file) for file in files]
    settings = asdict(experiment)
    settings["recording"]["path"] = None  # a film that was moved is the same film
    key = json.dumps([film.kind, contents, settings, code_digest(*FITTING_CODE)], sort_keys=True)
    return locate_in_cache("runs", key)


def _describe_run(film: DataSource, folder: Path, config: DiagnoseConfig) -> Finding:
    d, profile = config.film_d, config.film_profile
    name = Path(film.path).name
    taken = f"the film's mechanism was taken to have {d} coordinate{'s' if d > 1 else ''}"
    other = "diagnose.film_d=2 for two" if d == 1 else "diagnose.film_d=1 for one"
    return Finding(
        "note",
        "film as sim",
        name,
        f"the sim is the run fitted to {name} at profile {profile}, in {folder}; {taken}",
        "with another number of coordinates its law is another one",
        other,
    )


def _describe_cut(kept: Recording) -> list[Finding]:
    skip_s, end_s = kept.meta.get("skip_s") or 0.0, kept.meta.get("end_s")
    if not skip_s and end_s is None:
        return []
    until = "its end" if end_s is None else f"{end_s:g} s"
    what = f"of this film, the part from {skip_s:g} s to {until} was used"
    why = "the rest shows a cut, a repetition, or something that does not belong to the motion"
    return [
        Finding("note", "film cut", str(kept.meta["source"]), what, why, "cut the film to use another part")
    ]


def _is_complete(folder: Path) -> bool:
    return (folder / "dynamics.safetensors").is_file()  # which a fit writes last


def _fit(film: DataSource, experiment: Config, folder: Path, recording: Recording) -> None:
    set_threads(os.cpu_count() or 1)
    try:
        fit_run(experiment, out=folder, recording=recording)
    except (ValueError, FloatingPointError) as error:
        raise ValueError(f"{film.path}: no run could be fitted to this film. {error}") from error


def _read_film(film: DataSource, experiment: Config) -> tuple[Config, Recording]:
    """The film with its inputs, and the settings that suit it."""
    settings = experiment.recording
    if film.kind == "recording":
        recording = load_recording(film.path)
    elif film.kind == "krauss":
        recording = read_recording(settings)
    else:
        if film.kind == "video":
            settings = choose_frame_size(film.path, settings)
        recording = read_recording(settings)
        proposed = asdict(propose_settings(recording, settings))
        chart = replace(experiment.chart, smoothing_frames=proposed.pop("smoothing_frames"))
        stabilise = proposed.pop("stabilise") and film.kind == "video"
        suited = replace(settings, **proposed, stabilise=stabilise)
        if suited != settings:
            recording = read_recording(suited)
        experiment = replace(experiment, recording=suited, chart=chart)
    if film.inputs:
        recording = add_inputs(recording, film.inputs)
    return experiment, recording


def _check_film(film: DataSource, recording: Recording, experiment: Config) -> None:
    train, _ = split_train_held_out(recording, experiment.recording.split).split()
    if train.n_frames < LEAST_FRAMES:
        raise ValueError(
            f"{film.path}: {recording.n_frames} frames can be used, of which {train.n_frames} are for "
            f"training; it needs {LEAST_FRAMES} there, and several periods of the motion. Film for longer"
        )
    change = np.max(train.frames, axis=0).astype(int) - np.min(train.frames, axis=0)
    if change.max() <= LEVELS:
        raise ValueError(
            f"{film.path}: nothing moves in this film; no pixel changes by more than {change.max()} of 255. "
            "Film the mechanism in motion, larger in the picture"
        )


def _check_real(real: str, own: Recording, experiment: Config) -> None:
    settings: Mapping[str, Any] = asdict(experiment.recording)
    for source in () if real == HELD_OUT else find_sources(real):
        if source.kind not in VIDEO_KINDS:
            raise ValueError(
                f"{source.path}: a {source.kind} cannot be compared with a film as sim; give films, whose "
                "coordinates are those of the run that is fitted to it"
            )
        read_real_video(source, own, settings, dt_s=own.dt_s)
