"""Words of the command line: ``key=value`` of a command's own, and overrides of the configuration.

What ``lagsplat export`` writes: a function a format, each importing what its format needs.

The command line ``lagsplat VERB key=value ...``; keys of the configuration follow Hydra's grammar.

    lagsplat inspect FILE|FOLDER [key=value ...]                what is in a recording, a film or a log
    lagsplat fit out=FOLDER [key=value ...]                     every stage, in one process
    lagsplat simulate run=FOLDER out=q.csv [input=u.csv | seconds=10] [frame=N]
    lagsplat simulate run=OUT/augmented.safetensors out=q.csv [input=u.csv | seconds=10]
        [initial=q0,..,v0,.. | initial=state.csv] [input_hold=linear|zoh]
    lagsplat apply diagnosis=OUT/diagnosis.json out=augmented.safetensors [sim=SIM]
    lagsplat diagnose sim=SIM real=FILES [out=FOLDER] [diagnose.key=value ...]
    lagsplat evaluate run=FOLDER out=metrics.json [evaluate.key=value ...]
    lagsplat weights --download [out=FOLDER]                    published weights, for baseline.weights=FOLDER
    lagsplat view FOLDER [--no-browser] [diagnosis=FOLDER] [replay=session.mcap] [out=FOLDER]
        [viewer.key=value ...]                                  the run in a browser, to be pushed
    lagsplat export FOLDER --mcap [out=run.mcap] [key=value ...]  a run for Foxglove
    lagsplat export FOLDER --html [out=run.html]                one page to be pushed, without a server
    lagsplat export FOLDER --ply [out=run.ply] [frame=N | q=0.5,..]  a state for viewers of Gaussians

``input`` is a CSV with columns ``t`` [s] and ``u0, u1, ...``; between its rows inputs are interpolated.
``out`` then has columns ``t``, ``q0, ...`` (whitened) and ``v0, ...`` [1/s]. A sim with its diagnosed effects
also takes pushes ``f0, f1, ...`` along its coordinates: the accelerations they would give. ``apply`` adds the
effects of a diagnosis to a sim (a MuJoCo ``.xml``, ``file.py:attribute``, a run), by default to its own. Exit
code 2: the command or its input is invalid, and the reason stands on stderr.
"""

import logging
import os
import sys
import warnings
import zipfile
from collections.abc import Callable, Sequence
from dataclasses import asdict
from pathlib import Path
from typing import TYPE_CHECKING

from lagsplat.config.compose import ConfigError, closest, compose
from lagsplat.provenance import let_waiting_threads_sleep

if TYPE_CHECKING:
    import numpy as np


def split(
    words: list[str], *, needed: tuple[str, ...], allowed: tuple[str, ...]
) -> tuple[dict[str, str], list[str]]:
    """The command's own keys, and the overrides of the configuration."""
    pairs = [(word, *word.partition("=")[::2]) for word in words]
    own = {key: value for _, key, value in pairs if key in allowed}
    if missing := [key for key in needed if not own.get(key)]:
        raise ConfigError(f"{missing[0]}=... is missing")
    return own, [word for word, key, _ in pairs if key not in allowed]


def names_in(text: str | None) -> list[str] | None:
    """The names in ``[a,b]`` or ``a,b``; None of None."""
    if text is None:
        return None
    return [name.strip() for name in text.strip("[]").split(",") if name.strip()]


def _mcap(folder: Path, own: dict[str, str], changes: list[str], out: Path) -> None:
    from lagsplat.export.mcap import export_mcap
    from lagsplat.pipelines.evaluate import protocol
    from lagsplat.runs.run import open_run

    export_mcap(open_run(folder), protocol(folder, changes), out)


def _page(folder: Path, own: dict[str, str], changes: list[str], out: Path) -> None:
    from lagsplat.pipelines.view import export_page

    export_page(folder, compose(*changes), out)


def _ply(folder: Path, own: dict[str, str], changes: list[str], out: Path) -> None:
    from lagsplat.export.ply import export_ply
    from lagsplat.runs.run import open_run, state_of

    if changes:
        raise ConfigError(f"export --ply takes out, frame and q, not {changes[0]!r}")
    run = open_run(folder)
    export_ply(run.autoencoder, run.chart, state_of(run, own.get("frame"), own.get("q")), out)


EXPORTS: dict[str, Callable[[Path, dict[str, str], list[str], Path], None]] = {
    "mcap": _mcap,
    "html": _page,
    "ply": _ply,
}
"""By format: the folder of the run, its own words, changes of the configuration, the file to be written."""

OWN = ("run", "out", "input", "seconds", "frame")


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    let_waiting_threads_sleep()
    words = list(sys.argv[1:] if arguments is None else arguments)
    logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
    if not words or words[0] in ("-h", "--help", "help"):
        print(__doc__)
        return 0
    try:
        if words[0] not in VERBS:
            raise ConfigError(
                f"{words[0]!r} is no verb{closest(words[0], list(VERBS))}; choose {', '.join(VERBS)}"
            )
        VERBS[words[0]](words[1:])
    except (ValueError, OSError) as error:
        print(f"lagsplat {words[0]}: {error}", file=sys.stderr)
        return 2
    return 0


def _inspect(words: list[str]) -> None:
    if not words or "=" in words[0]:
        raise ConfigError("name a file: lagsplat inspect FILE, or a folder of films or images")
    from lagsplat.io.read import read_recording
    from lagsplat.io.recording.recording import load_recording
    from lagsplat.io.recording.segments import divide
    from lagsplat.report.inspection import describe, describe_footage, propose_system

    path = Path(words[0]).expanduser()
    if not path.exists():
        raise FileNotFoundError(f"{path}: no such file or folder; check the path")
    if path.suffix == ".mcap":
        from lagsplat.io.mcap.recording import survey
        from lagsplat.report.inspection import describe_log

        print(describe_log(survey(path)))
        if not any(word.startswith("recording.mcap.camera=") for word in words):
            return
        print()
    experiment = compose(*_reading(path), *words[1:])
    kept = path.suffix == ".safetensors"
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = load_recording(path) if kept else read_recording(experiment.recording)
    print(describe(divide(recording, experiment.recording.split), config=experiment.evaluate))
    if recording.meta.get("footage"):
        told = describe_footage(recording)
        print(told)
        said = [str(warning.message) for warning in caught]
        for text in (text for text in said if text.partition(": ")[2] not in told):
            print(f"warning    {text}")
        if experiment.recording.kind == "video":
            print(propose_system(recording, path=path, settings=experiment.recording))


def _reading(path: Path) -> list[str]:
    """How a file is read unless told otherwise: an archive by its pressures, a log by what is said of it,
    anything else as a film."""
    source = ["recording=filmed", f"recording.path={str(path)!r}"]
    if path.suffix == ".safetensors":
        return source
    if path.suffix == ".mcap":
        return [*source, "recording.kind=mcap"]
    if path.suffix != ".npz":
        return [*source, "recording.kind=video", "recording.n_inputs=0", "recording.dt_s=null"]
    names = zipfile.ZipFile(path).namelist() if zipfile.is_zipfile(path) else []
    pressures = sum(name.removesuffix(".npy")[1:].isdigit() for name in names if name.startswith("p"))
    return [*source, "recording.kind=krauss", f"recording.n_inputs={pressures}"]


def _fit(words: list[str]) -> None:
    from lagsplat.provenance import code_digest, set_threads
    from lagsplat.runs.fit import fit

    own, rest = split(words, needed=("out",), allowed=("out",))
    set_threads(os.cpu_count() or 1)
    experiment = compose(*rest)
    header = {"config": asdict(experiment), "code": code_digest("lagsplat.runs.run")}
    fit(experiment, out=Path(own["out"]), header=header)
    print(own["out"])


def _evaluate(words: list[str]) -> None:
    from lagsplat.io.files.json_files import save_json
    from lagsplat.pipelines.evaluate import protocol, score
    from lagsplat.runs.run import open_run

    own, changes = split(words, needed=("run", "out"), allowed=("run", "out"))
    folder = Path(own["run"])
    run = open_run(folder)
    save_json(own["out"], score(run, protocol(folder, changes)))
    print(own["out"])


def _weights(words: list[str]) -> None:
    from lagsplat.baselines.released import FILES, NOTICE, fetch_weights

    own, rest = split([word for word in words if word != "--download"], needed=(), allowed=("out",))
    if rest:
        raise ConfigError(f"weights takes out=FOLDER and --download, not {rest[0]!r}")
    if "--download" not in words:
        raise ConfigError(
            f"{NOTICE}. Nothing was fetched; add --download to fetch {len(FILES)} files of 10 MB"
        )
    folder = Path(own.get("out", "~/.cache/lagsplat/baselines")).expanduser()
    print(NOTICE, file=sys.stderr)
    fetch_weights(folder)
    print(folder)


def _export(words: list[str]) -> None:
    folders = [word for word in words if "=" not in word and not word.startswith("--")]
    formats = [word for word in words if word.startswith("--")]
    kind = formats[0].removeprefix("--") if len(formats) == 1 else ""
    if len(folders) != 1 or kind not in EXPORTS:
        raise ConfigError(
            "name one run and the format: lagsplat export FOLDER --mcap|--html|--ply [out=FILE]"
        )
    allowed = ("out", "frame", "q") if kind == "ply" else ("out",)
    own, changes = split([word for word in words if "=" in word], needed=(), allowed=allowed)
    folder = Path(folders[0])
    out = Path(own.get("out", str(folder / f"run.{kind}")))
    EXPORTS[kind](folder, own, changes, out)
    print(out)


def _view(words: list[str]) -> None:
    from lagsplat.pipelines.view import view

    folders = [word for word in words if "=" not in word and not word.startswith("--")]
    flags = [word for word in words if word.startswith("--")]
    if len(folders) != 1 or flags not in ([], ["--no-browser"]):
        raise ConfigError("name one fitted run: lagsplat view FOLDER [--no-browser] [viewer.port=8080]")
    allowed = ("out", "replay", "diagnosis")
    own, changes = split([word for word in words if "=" in word], needed=(), allowed=allowed)
    if other := [word for word in changes if not word.startswith(("viewer.", "forces."))]:
        raise ConfigError(f"view takes viewer.key and forces.key, {', '.join(allowed)}, not {other[0]!r}")
    view(Path(folders[0]), compose(*changes), own, browser=not flags)


def _simulate(words: list[str]) -> None:
    import numpy as np

    from lagsplat.io.files.json_files import load_inputs
    from lagsplat.runs.run import open_run, push

    if any(Path(word[4:]).is_file() for word in words if word.startswith("run=")):
        _play(words)
        return
    own, rest = split(words, needed=("run", "out"), allowed=OWN)
    if rest:
        raise ConfigError(f"simulate takes {', '.join(OWN)} alone, not {rest[0]!r}: a run keeps its settings")
    if "input" in own and "seconds" in own:
        raise ConfigError("input= and seconds= exclude each other: a file of inputs has its own length")
    run = open_run(Path(own["run"]))
    dt_s, n_u = run.chart.dt_s, run.chart.inputs.shape[1]
    if "input" in own:
        time_s, inputs = load_inputs(own["input"], dt_s=dt_s)
    else:
        time_s = np.arange(0.0, float(own.get("seconds", "10")), dt_s)
        inputs = np.zeros((len(time_s), n_u))
    q, v = push(run, inputs, frame=int(own["frame"]) if "frame" in own else None)
    _save_motion(own["out"], time_s, q, v)


def _play(words: list[str]) -> None:
    import numpy as np

    from lagsplat.diagnose.augmented.model import load_augmented
    from lagsplat.diagnose.augmented.simulate import AppliedSignals, simulate_augmented
    from lagsplat.io.trajectory.inputs import read_drive, read_state

    allowed = ("run", "out", "input", "seconds", "initial", "input_hold")
    own, rest = split(words, needed=("run", "out"), allowed=allowed)
    if rest:
        raise ConfigError(f"simulate takes {', '.join(allowed)} for such a file, not {rest[0]!r}")
    if "input" in own and "seconds" in own:
        raise ConfigError("input= and seconds= exclude each other: a file of inputs has its own length")
    hold = own.get("input_hold")
    if hold not in (None, "linear", "zoh"):
        raise ConfigError(f"input_hold={hold}: choose linear or zoh")
    sim = load_augmented(own["run"])
    if "input" in own:
        time_s, u, push = read_drive(own["input"])
    else:
        time_s = np.arange(0.0, float(own.get("seconds", "10")), sim.dt_s)
        u, push = np.zeros((len(time_s), sim.model.n_u)), np.zeros((len(time_s), 0))
    start = read_state(own["initial"], sim.model.d) if "initial" in own else (None, None)
    held = None if hold is None else hold == "zoh"
    drive = AppliedSignals(time_s, u, push if push.shape[1] else None)
    q, v = simulate_augmented(sim, drive, q=start[0], v=start[1], held=held)
    _save_motion(own["out"], time_s, q, v)


def _save_motion(out: str, time_s: "np.ndarray", q: "np.ndarray", v: "np.ndarray") -> None:
    from lagsplat.io.files.json_files import save_csv

    rows = [
        {"t": t}
        | {f"q{i}": value for i, value in enumerate(state)}
        | {f"v{i}": value for i, value in enumerate(velocity)}
        for t, state, velocity in zip(time_s, q, v, strict=True)
    ]
    save_csv(out, rows)
    print(out)


def _diagnose(words: list[str]) -> None:
    from lagsplat.pipelines.diagnosis import diagnose_files
    from lagsplat.report.diagnosis.summary import paragraph

    own, rest = split(words, needed=("sim", "real"), allowed=("sim", "real", "out"))
    if other := [word for word in rest if not word.startswith("diagnose")]:
        raise ConfigError(f"diagnose takes sim, real, out and diagnose.key=value, not {other[0]!r}")
    out = Path(own.get("out", "diagnosis"))
    command = " ".join(["lagsplat diagnose", *words])
    found = diagnose_files(own["sim"], own["real"], out, compose(*rest).diagnose, command=command)
    for text in found.warnings:
        print(f"warning: {text}", file=sys.stderr)
    print(paragraph(found))
    print(out / "report.html")


def _apply(words: list[str]) -> None:
    from lagsplat.pipelines.apply_diagnosis import apply_diagnosis

    allowed = ("diagnosis", "sim", "out", "diagnose.joints", "diagnose.actuators")
    own, rest = split(words, needed=("diagnosis", "out"), allowed=allowed)
    if rest:
        raise ConfigError(f"apply takes {', '.join(allowed)}, not {rest[0]!r}")
    names = {key: names_in(own.get(f"diagnose.{key}")) for key in ("joints", "actuators")}
    apply_diagnosis(Path(own["diagnosis"]), own.get("sim"), out=Path(own["out"]), **names)
    print(own["out"])


VERBS: dict[str, Callable[[list[str]], None]] = {
    "inspect": _inspect,
    "fit": _fit,
    "simulate": _simulate,
    "diagnose": _diagnose,
    "evaluate": _evaluate,
    "view": _view,
    "export": _export,
    "weights": _weights,
    "apply": _apply,
}
