"""What each verb of the command line does, from its words to its printed lines, in a function of its name."""

import os
import shlex
import sys
import warnings
from argparse import Namespace
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lagsplat.cli.main import CommandError, split_words
from lagsplat.config.compose import compose
from lagsplat.provenance import set_threads

if TYPE_CHECKING:
    from lagsplat.io.config import RecordingConfig
    from lagsplat.io.recording.recording import Recording

FITTED_RUN_KEYS = ("input", "seconds", "frame")
MOST_SAMPLES = 10_000_000  # of a simulation
AUGMENTED_KEYS = ("input", "seconds", "initial", "input_hold")


def init(given: Namespace) -> None:
    """Lay down the pipeline in a new folder, and say what to type next."""
    if len(given.words) != 1 or "=" in given.words[0]:
        raise CommandError("name one folder that is new or empty: lagsplat init FOLDER")
    from lagsplat.io.files.pipeline_copy import copy_pipeline
    from lagsplat.project import PARTS

    folder = copy_pipeline(given.words[0])
    print(f"{folder}: {', '.join(PARTS)}\nnext:")
    print(f"  cd {shlex.quote(str(folder))}")
    print("  snakemake -c2 -n                                            # what would be made")
    print("  snakemake -c2 results/figures/rollout_rainbow_rocker.pdf    # one system, fitted and drawn")


def inspect(given: Namespace) -> None:
    """Print what a recording, a video, a table, a log, a LeRobot dataset, an HDF5 file or a model holds."""
    words = given.words
    if not words or "=" in words[0]:
        raise CommandError("name a file: lagsplat inspect FILE, or a folder of videos or images")
    path = Path(words[0]).expanduser()
    keys, overrides = split_words(words[1:], allowed=("sheet",))
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file or folder; check the path")
    survey = _survey_numbers(path, overrides)
    if survey:
        print(survey)
        cameras = ("recording.mcap.camera=", "recording.lerobot.camera=")
        if not any(word.startswith(cameras) for word in overrides):
            return
        print()
    from lagsplat.io.read import read_recording
    from lagsplat.io.recording.recording import load_recording
    from lagsplat.io.recording.segments import split_train_held_out
    from lagsplat.io.video.proposal import choose_frame_size
    from lagsplat.pipelines.steps import reading_overrides
    from lagsplat.report.inspection.recording import describe_recording, describe_video

    experiment = compose(*reading_overrides(path), *overrides)
    settings, is_artefact = experiment.recording, path.suffix == ".safetensors"
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        if settings.kind == "video":
            settings = choose_frame_size(path, settings)
        recording = load_recording(path) if is_artefact else read_recording(settings)
    divided = split_train_held_out(recording, settings.split)
    print(describe_recording(divided, config=experiment.evaluate))
    if recording.meta.get("footage"):
        description = describe_video(recording)
        print(description)
        for text in (str(warning.message) for warning in caught):
            if text.partition(": ")[2] not in description:
                print(f"warning    {text}")
        if settings.kind == "video":
            sheet = Path(keys.get("sheet") or f"{path.stem}_inspected.png").expanduser()
            _propose_from_video(recording, settings, path=path, sheet=sheet)


def _propose_from_video(
    recording: "Recording", settings: "RecordingConfig", *, path: Path, sheet: Path
) -> None:
    """Print what a video asks for, and draw it on a sheet."""
    from lagsplat.io.video.clips import find_clips
    from lagsplat.io.video.decode import read_first_image
    from lagsplat.io.video.proposal import measure_kept_motion, propose_crop
    from lagsplat.report.common.style import save_figure
    from lagsplat.report.figures.film_sheet import draw_film_sheet
    from lagsplat.report.inspection.recording import propose_system

    motion = measure_kept_motion(recording, settings)
    crop = propose_crop(recording, settings, motion)
    if not motion.any():
        print("warning    nothing moves by more than a level of 255: there is nothing to learn from")
    first = read_first_image(find_clips(path)[0], rotate=settings.rotate, dt_s=settings.dt_s)
    drawn = crop or settings.crop
    save_figure(sheet, draw_film_sheet(first, motion, drawn, title=f"{path.name}, before anything is fitted"))
    print(f"sheet      {sheet.resolve()}")
    print(propose_system(recording, path=path, settings=settings, crop=crop))


def _survey_numbers(path: Path, overrides: Sequence[str]) -> str:
    """Describe a simulator, or what may be read of a log or a table; empty of another file or folder."""
    from lagsplat.io.lerobot.dataset import is_lerobot
    from lagsplat.io.mujoco.model import URDF
    from lagsplat.io.robot_log.storage import is_log
    from lagsplat.io.sources import find_sources
    from lagsplat.io.trajectory.hdf5 import HDF5_SUFFIXES
    from lagsplat.io.trajectory.tables import KINDS

    if is_lerobot(path):
        from lagsplat.io.lerobot.survey import survey_lerobot
        from lagsplat.report.inspection.dataset import describe_lerobot

        return describe_lerobot(survey_lerobot(path))
    if path.suffix.lower() in HDF5_SUFFIXES:
        from lagsplat.io.trajectory.hdf5 import survey_hdf5
        from lagsplat.report.inspection.dataset import describe_hdf5

        return describe_hdf5(survey_hdf5(path))
    if is_log(path):
        from lagsplat.io.robot_log.survey import survey_log
        from lagsplat.report.inspection.log import describe_log

        return describe_log(survey_log(path))
    if path.is_file() and path.suffix.lower() in KINDS and find_sources(str(path))[0].kind == "trajectory":
        from lagsplat.report.inspection.table import describe_table

        return describe_table(path, compose(*overrides).diagnose.columns)
    if path.suffix.lower() in (".xml", URDF):
        from lagsplat.report.inspection.mechanism import describe_mechanism

        return describe_mechanism(path)
    return ""


def fit(given: Namespace) -> None:
    """Fit every stage to one recording."""
    keys, overrides = split_words(given.words, needed=("out",))
    experiment = compose(*overrides)
    from lagsplat.runs.fit import fit_run

    set_threads(os.cpu_count() or 1)
    fit_run(experiment, out=Path(keys["out"]))
    print(keys["out"])


def simulate(given: Namespace) -> None:
    """Simulate a fitted run, or an augmented simulator where ``run=`` is a file."""
    augmented = any(Path(word[4:]).is_file() for word in given.words if word.startswith("run="))
    allowed = AUGMENTED_KEYS if augmented else FITTED_RUN_KEYS
    keys, _ = split_words(given.words, needed=("run", "out"), allowed=allowed, settings=())
    if "input" in keys and "seconds" in keys:
        raise CommandError("input= and seconds= exclude each other: a file of inputs has its own length")
    time_s, q, v = _simulate_augmented(keys) if augmented else _simulate_run(keys)
    from lagsplat.io.files.atomic import save_csv

    rows = []
    for t, state, velocity in zip(time_s, q, v, strict=True):
        states = {f"q{i}": value for i, value in enumerate(state)}
        rows.append({"t": t} | states | {f"v{i}": value for i, value in enumerate(velocity)})
    save_csv(keys["out"], rows)
    print(keys["out"])


def sample_times(seconds: str, dt_s: float) -> np.ndarray:
    """Times from 0 to ``seconds`` in steps of ``dt_s`` [s], (N,).

    Raises:
        CommandError: no duration that can be simulated.
    """
    try:
        duration_s = float(seconds)
    except ValueError:
        duration_s = float("nan")
    if not dt_s <= duration_s <= MOST_SAMPLES * dt_s:
        raise CommandError(
            f"seconds={seconds}: give a duration in seconds from {dt_s:.3g}, one sample, to "
            f"{MOST_SAMPLES * dt_s:.3g}, ten million samples"
        )
    return np.arange(0.0, duration_s, dt_s)


def _simulate_run(keys: dict[str, str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Times (N,) [s], states (N, d) and velocities (N, d) [1/s] of a fitted run."""
    from lagsplat.io.trajectory.inputs import interpolate_inputs, read_input_table
    from lagsplat.runs.run import open_run, rollout

    run = open_run(Path(keys["run"]))
    if "input" in keys:
        time_s, inputs, push = read_input_table(keys["input"])
        if push.shape[1]:
            raise CommandError(
                f"input={keys['input']}: a fitted run takes no f0, f1, ...; drop these columns"
            )
        time_s, inputs = interpolate_inputs(time_s, inputs, dt_s=run.chart.dt_s, most=MOST_SAMPLES)
    else:
        time_s = sample_times(keys.get("seconds", "10"), run.chart.dt_s)
        inputs = np.zeros((len(time_s), run.chart.inputs.shape[1]))
    return time_s, *rollout(run, inputs, frame=int(keys["frame"]) if "frame" in keys else None)


def _simulate_augmented(keys: dict[str, str]) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same of an augmented simulator."""
    input_hold = keys.get("input_hold")
    if input_hold not in (None, "linear", "zoh"):
        raise CommandError(f"input_hold={input_hold}: choose linear or zoh")
    from lagsplat.diagnose.augmented.model import load_augmented
    from lagsplat.diagnose.augmented.simulate import AppliedSignals, simulate_augmented
    from lagsplat.io.trajectory.inputs import read_initial_state, read_input_table

    sim = load_augmented(keys["run"])
    if "input" in keys:
        time_s, u, push = read_input_table(keys["input"])
    else:
        time_s = sample_times(keys.get("seconds", "10"), sim.dt_s)
        u, push = np.zeros((len(time_s), sim.model.n_u)), np.zeros((len(time_s), 0))
    q, v = read_initial_state(keys["initial"], sim.model.d) if "initial" in keys else (None, None)
    held = None if input_hold is None else input_hold == "zoh"
    drive = AppliedSignals(time_s, u, push if push.shape[1] else None)
    return time_s, *simulate_augmented(sim, drive, q=q, v=v, held=held)


def evaluate(given: Namespace) -> None:
    """Score a fitted run."""
    keys, changes = split_words(given.words, needed=("run", "out"))
    from lagsplat.io.files.atomic import save_json
    from lagsplat.pipelines.steps import evaluate as score

    save_json(keys["out"], score(keys["run"], *changes))
    print(keys["out"])


def view(given: Namespace) -> None:
    """Serve a fitted run to the browser."""
    folders = [word for word in given.words if "=" not in word]
    if len(folders) != 1:
        raise CommandError(
            "name one fitted run or page: lagsplat view FOLDER|PAGE.html [--no-browser] [viewer.port=8080]"
        )
    words, allowed = [word for word in given.words if "=" in word], ("diagnosis", "replay", "out")
    keys, changes = split_words(words, allowed=allowed, settings=("viewer.", "forces."))
    if folders[0].lower().endswith((".html", ".htm")):
        show_page(Path(folders[0]).expanduser(), keys | dict.fromkeys(changes), browser=not given.no_browser)
        return
    from lagsplat.pipelines.view import view as serve

    diagnosis, replay, out = (keys.get(name) for name in allowed)
    browser = not given.no_browser
    serve(folders[0], *changes, browser=browser, diagnosis=diagnosis, replay=replay, out=out)


def show_page(page: Path, others: Mapping[str, str | None], *, browser: bool) -> None:
    """Open an exported page, which computes in the browser and needs nothing of this package.

    Raises:
        CommandError: there are settings besides, which the page does not read.
        FileNotFoundError: the page is not there.
    """
    if others:
        raise CommandError(
            f"{page} is a page: {next(iter(others))} has no effect on it; name the run's folder"
        )
    if not page.is_file():
        raise FileNotFoundError(f"{page}: no such page; `lagsplat export FOLDER --html` writes one")
    print(page.resolve().as_uri())
    if browser:
        import webbrowser

        webbrowser.open(page.resolve().as_uri())


def export(given: Namespace) -> None:
    """Write a fitted run, or a diagnosis, in one of four formats."""
    folders = [word for word in given.words if "=" not in word]
    formats = [name for name in ("html", "mcap", "ply", "sysid") if getattr(given, name)]
    if len(folders) != 1 or len(formats) != 1:
        raise CommandError(
            "name one run and a format: lagsplat export FOLDER --mcap|--html|--ply [out=FILE], or a "
            "diagnosis: lagsplat export FOLDER --sysid [out=FOLDER]"
        )
    kind, folder = formats[0], Path(folders[0])
    words = [word for word in given.words if "=" in word]
    allowed, settings = (("out", "frame", "q"), ()) if kind == "ply" else (("out",), ("",))
    settings = () if kind == "sysid" else settings
    keys, changes = split_words(words, allowed=allowed, settings=settings)
    if kind == "sysid":
        from lagsplat.pipelines.sysid_export import export_sysid

        print("\n".join(str(path) for path in export_sysid(folder, Path(keys.get("out", folder / "sysid")))))
        return
    out = Path(keys.get("out", folder / f"run.{kind}"))
    from lagsplat.runs.run import choose_state, open_run

    if kind == "html":
        from lagsplat.pipelines.view import export_page

        export_page(folder, out, *changes)
    elif kind == "mcap":
        from lagsplat.pipelines.export import export_mcap
        from lagsplat.pipelines.steps import read_protocol

        export_mcap(open_run(folder), read_protocol(folder, changes), out)
    else:
        from lagsplat.pipelines.export import export_ply

        run = open_run(folder)
        export_ply(run.autoencoder, run.chart, choose_state(run, keys.get("frame"), keys.get("q")), out)
    print(out)


def weights(given: Namespace) -> None:
    """Download the published weights of the baselines, if ``--download`` says so."""
    keys, _ = split_words(given.words, allowed=("out",), settings=())
    from lagsplat.baselines.released import NOTICE, RUNS, fetch_weights

    if not given.download:
        raise CommandError(f"{NOTICE}. Nothing was fetched; add --download for {len(RUNS)} files of 10 MB")
    folder = Path(keys.get("out", "~/.cache/lagsplat/baselines")).expanduser()
    print(NOTICE, file=sys.stderr)
    fetch_weights(folder)
    print(folder)


def diagnose(given: Namespace) -> None:
    """Diagnose ``sim`` against ``real``, and write the report."""
    needed = ("sim", "real")
    keys, overrides = split_words(given.words, needed=needed, allowed=("out",), settings=("diagnose.",))
    config = compose(*overrides).diagnose
    from lagsplat.pipelines.diagnosis import diagnose_files
    from lagsplat.report.diagnosis.lines import write_lines

    out = Path(keys.get("out", "diagnosis"))
    diagnosis = diagnose_files(keys["sim"], keys["real"], out, config, command=given.text)
    print("\n".join(write_lines(diagnosis, report=out / "report.html")))


def apply(given: Namespace) -> None:
    """Add the effects of a diagnosis to a simulator."""
    allowed = ("sim", "diagnose.joints", "diagnose.actuators", "diagnose.parameters")
    keys, _ = split_words(given.words, needed=("diagnosis", "out"), allowed=allowed, settings=())
    from lagsplat.pipelines.apply_diagnosis import apply_diagnosis

    joints, actuators = (parse_names(keys.get(key)) for key in allowed[1:3])
    apply_diagnosis(
        keys["diagnosis"],
        keys.get("sim"),
        out=keys["out"],
        joints=joints,
        actuators=actuators,
        parameters=keys.get(allowed[3]),
    )
    print(keys["out"])


def parse_names(text: str | None) -> list[str] | None:
    """The names in ``[a,b]`` or ``a,b``; None if nothing is given."""
    if text is None:
        return None
    return [name.strip() for name in text.strip("[]").split(",") if name.strip()]
