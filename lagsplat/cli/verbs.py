"""What each verb of the command line does, from its words to its printed lines."""

import os
import sys
import warnings
from argparse import Namespace
from pathlib import Path

import numpy as np
from jaxtyping import Float64

from lagsplat.cli.main import CommandError, split_words
from lagsplat.config.compose import compose
from lagsplat.provenance import set_threads

FITTED_RUN_KEYS = ("run", "out", "input", "seconds", "frame")
AUGMENTED_KEYS = ("run", "out", "input", "seconds", "initial", "input_hold")


def inspect_file(given: Namespace) -> None:
    """Print what a recording, a video or a log holds."""
    words = given.words
    if not words or "=" in words[0]:
        raise CommandError("name a file: lagsplat inspect FILE, or a folder of videos or images")
    path = Path(words[0]).expanduser()
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file or folder; check the path")
    from lagsplat.io.read import read_recording
    from lagsplat.io.recording.recording import load_recording
    from lagsplat.io.recording.segments import split_train_held_out
    from lagsplat.pipelines.steps import reading_overrides
    from lagsplat.report.inspection import describe_recording, describe_video, propose_system

    if path.suffix == ".mcap":
        from lagsplat.io.mcap.recording import survey_mcap
        from lagsplat.report.inspection import describe_mcap

        print(describe_mcap(survey_mcap(path)))
        if not any(word.startswith("recording.mcap.camera=") for word in words):
            return
        print()
    experiment = compose(*reading_overrides(path), *words[1:])
    is_artefact = path.suffix == ".safetensors"
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = load_recording(path) if is_artefact else read_recording(experiment.recording)
    print(
        describe_recording(
            split_train_held_out(recording, experiment.recording.split), config=experiment.evaluate
        )
    )
    if recording.meta.get("footage"):
        description = describe_video(recording)
        print(description)
        for text in (str(warning.message) for warning in caught):
            if text.partition(": ")[2] not in description:
                print(f"warning    {text}")
        if experiment.recording.kind == "video":
            print(propose_system(recording, path=path, settings=experiment.recording))


def fit_recording(given: Namespace) -> None:
    """Fit every stage to one recording."""
    keys, overrides = split_words(given.words, needed=("out",), allowed=("out",))
    experiment = compose(*overrides)
    from lagsplat.runs.fit import fit_run

    set_threads(os.cpu_count() or 1)
    fit_run(experiment, out=Path(keys["out"]))
    print(keys["out"])


def simulate(given: Namespace) -> None:
    """Simulate a fitted run, or an augmented simulator where ``run=`` is a file."""
    if any(Path(word[4:]).is_file() for word in given.words if word.startswith("run=")):
        _simulate_augmented(given.words)
        return
    keys, rest = split_words(given.words, needed=("run", "out"), allowed=FITTED_RUN_KEYS)
    if rest:
        raise CommandError(
            f"simulate takes {', '.join(FITTED_RUN_KEYS)} alone, not {rest[0]!r}: a run keeps its settings"
        )
    _require_one_duration(keys)
    from lagsplat.io.files.atomic import load_inputs
    from lagsplat.runs.run import open_run, rollout

    run = open_run(Path(keys["run"]))
    dt_s, n_u = run.chart.dt_s, run.chart.inputs.shape[1]
    if "input" in keys:
        time_s, inputs = load_inputs(keys["input"], dt_s=dt_s)
    else:
        time_s = np.arange(0.0, float(keys.get("seconds", "10")), dt_s)
        inputs = np.zeros((len(time_s), n_u))
    q, v = rollout(run, inputs, frame=int(keys["frame"]) if "frame" in keys else None)
    _save_states(keys["out"], time_s, q, v)


def _simulate_augmented(words: list[str]) -> None:
    keys, rest = split_words(words, needed=("run", "out"), allowed=AUGMENTED_KEYS)
    if rest:
        raise CommandError(f"simulate takes {', '.join(AUGMENTED_KEYS)} for such a file, not {rest[0]!r}")
    _require_one_duration(keys)
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
        time_s = np.arange(0.0, float(keys.get("seconds", "10")), sim.dt_s)
        u, push = np.zeros((len(time_s), sim.model.n_u)), np.zeros((len(time_s), 0))
    start = read_initial_state(keys["initial"], sim.model.d) if "initial" in keys else (None, None)
    held = None if input_hold is None else input_hold == "zoh"
    drive = AppliedSignals(time_s, u, push if push.shape[1] else None)
    q, v = simulate_augmented(sim, drive, q=start[0], v=start[1], held=held)
    _save_states(keys["out"], time_s, q, v)


def _require_one_duration(keys: dict[str, str]) -> None:
    if "input" in keys and "seconds" in keys:
        raise CommandError("input= and seconds= exclude each other: a file of inputs has its own length")


def _save_states(
    out: str, time_s: Float64[np.ndarray, " N"], q: Float64[np.ndarray, "N d"], v: Float64[np.ndarray, "N d"]
) -> None:
    from lagsplat.io.files.atomic import save_csv

    rows = [
        {"t": t}
        | {f"q{i}": value for i, value in enumerate(state)}
        | {f"v{i}": value for i, value in enumerate(velocity)}
        for t, state, velocity in zip(time_s, q, v, strict=True)
    ]
    save_csv(out, rows)
    print(out)


def evaluate(given: Namespace) -> None:
    """Score a fitted run."""
    keys, changes = split_words(given.words, needed=("run", "out"), allowed=("run", "out"))
    from lagsplat.io.files.atomic import save_json
    from lagsplat.pipelines.evaluate import evaluate_run, read_protocol
    from lagsplat.runs.run import open_run

    run = open_run(Path(keys["run"]))
    save_json(keys["out"], evaluate_run(run, read_protocol(Path(keys["run"]), changes)))
    print(keys["out"])


def view(given: Namespace) -> None:
    """Serve a fitted run to the browser."""
    folders = [word for word in given.words if "=" not in word]
    if len(folders) != 1:
        raise CommandError("name one fitted run: lagsplat view FOLDER [--no-browser] [viewer.port=8080]")
    allowed = ("out", "replay", "diagnosis")
    keys, changes = split_words([word for word in given.words if "=" in word], allowed=allowed)
    if other := [word for word in changes if not word.startswith(("viewer.", "forces."))]:
        raise CommandError(f"view takes viewer.key and forces.key, {', '.join(allowed)}, not {other[0]!r}")
    from lagsplat.pipelines.view import view as serve

    serve(Path(folders[0]), compose(*changes), keys, browser=not given.no_browser)


def export(given: Namespace) -> None:
    """Write a fitted run in one of three formats."""
    folders = [word for word in given.words if "=" not in word]
    formats = [name for name in ("html", "mcap", "ply") if getattr(given, name)]
    if len(folders) != 1 or len(formats) != 1:
        raise CommandError(
            "name one run and the format: lagsplat export FOLDER --mcap|--html|--ply [out=FILE]"
        )
    kind, folder = formats[0], Path(folders[0])
    allowed = ("out", "frame", "q") if kind == "ply" else ("out",)
    keys, changes = split_words([word for word in given.words if "=" in word], allowed=allowed)
    out = Path(keys.get("out", str(folder / f"run.{kind}")))
    {"html": _export_page, "mcap": _export_log, "ply": _export_gaussians}[kind](folder, keys, changes, out)
    print(out)


def _export_log(folder: Path, keys: dict[str, str], changes: list[str], out: Path) -> None:
    from lagsplat.pipelines.evaluate import read_protocol
    from lagsplat.pipelines.export import export_mcap
    from lagsplat.runs.run import open_run

    export_mcap(open_run(folder), read_protocol(folder, changes), out)


def _export_page(folder: Path, keys: dict[str, str], changes: list[str], out: Path) -> None:
    from lagsplat.pipelines.view import export_page

    export_page(folder, compose(*changes), out)


def _export_gaussians(folder: Path, keys: dict[str, str], changes: list[str], out: Path) -> None:
    from lagsplat.pipelines.export import export_ply
    from lagsplat.runs.run import choose_state, open_run

    if changes:
        raise CommandError(f"export --ply takes out, frame and q, not {changes[0]!r}")
    run = open_run(folder)
    export_ply(run.autoencoder, run.chart, choose_state(run, keys.get("frame"), keys.get("q")), out)


def download_weights(given: Namespace) -> None:
    """Download the published weights of the baselines, if ``--download`` says so."""
    keys, rest = split_words(given.words, allowed=("out",))
    if rest:
        raise CommandError(f"weights takes out=FOLDER and --download, not {rest[0]!r}")
    from lagsplat.baselines.released import NOTICE, RUNS, fetch_weights

    if not given.download:
        raise CommandError(
            f"{NOTICE}. Nothing was fetched; add --download to fetch {len(RUNS)} files of 10 MB"
        )
    folder = Path(keys.get("out", "~/.cache/lagsplat/baselines")).expanduser()
    print(NOTICE, file=sys.stderr)
    fetch_weights(folder)
    print(folder)


def diagnose(given: Namespace) -> None:
    """Diagnose ``sim`` against ``real``, and write the report."""
    keys, overrides = split_words(given.words, needed=("sim", "real"), allowed=("sim", "real", "out"))
    if other := [word for word in overrides if not word.startswith("diagnose")]:
        raise CommandError(f"diagnose takes sim, real, out and diagnose.key=value, not {other[0]!r}")
    config = compose(*overrides).diagnose
    from lagsplat.pipelines.diagnosis import diagnose_files
    from lagsplat.report.diagnosis.summary import write_summary

    out = Path(keys.get("out", "diagnosis"))
    diagnosis = diagnose_files(keys["sim"], keys["real"], out, config, command=given.text)
    for text in diagnosis.warnings:
        print(f"warning: {text}", file=sys.stderr)
    print(write_summary(diagnosis))
    print(out / "report.html")


def apply(given: Namespace) -> None:
    """Add the effects of a diagnosis to a simulator."""
    allowed = ("diagnosis", "sim", "out", "diagnose.joints", "diagnose.actuators")
    keys, rest = split_words(given.words, needed=("diagnosis", "out"), allowed=allowed)
    if rest:
        raise CommandError(f"apply takes {', '.join(allowed)}, not {rest[0]!r}")
    from lagsplat.pipelines.apply_diagnosis import apply_diagnosis

    names = {name: parse_names(keys.get(f"diagnose.{name}")) for name in ("joints", "actuators")}
    apply_diagnosis(Path(keys["diagnosis"]), keys.get("sim"), out=Path(keys["out"]), **names)
    print(keys["out"])


def parse_names(text: str | None) -> list[str] | None:
    """The names in ``[a,b]`` or ``a,b``; None if nothing is given."""
    if text is None:
        return None
    return [name.strip() for name in text.strip("[]").split(",") if name.strip()]
