"""The command line: ``lagsplat VERB ...``, its help and its exit codes.

This module loads nothing but the standard library, so that ``--help`` answers at once. The function of a verb
has its name in `lagsplat.cli.verbs`, which is imported when a verb runs.
"""

import argparse
import logging
import sys
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, NoReturn

EXIT_CODES = """exit codes:
  0  done; for diagnose, whatever the verdict
  2  the command or its input is invalid; the reason is on stderr"""


class CommandError(ValueError):
    """A command line that cannot be understood; the message says what to write instead."""


@dataclass(frozen=True)
class Verb:
    """One verb of the command line and its help."""

    summary: str
    usage: tuple[str, ...]  # ways to call it, without `lagsplat` and the verb
    keys: tuple[tuple[str, str], ...]  # each `key=VALUE` it takes, and what it is for
    example: str
    flags: tuple[tuple[str, str], ...] = ()  # each `--flag` it takes, and what it does


CONFIGURATION = ("KEY=VALUE", "any key of conf/, in Hydra's grammar: stage1.steps=9000 system=rainbow_rocker")
VERBS = {
    "init": Verb(
        summary="Lay down the pipeline in a new folder: Snakefile, settings, rules.",
        usage=("FOLDER",),
        keys=(("FOLDER", "new or empty; what stands in it stays as it is"),),
        example="lagsplat init rocker && cd rocker && snakemake -c2 -n",
    ),
    "inspect": Verb(
        summary="Describe a film, a log, a table, a dataset or a model, and how to read it.",
        usage=("FILE|FOLDER [sheet=FILE.png] [key=value ...]",),
        keys=(
            (
                "sheet=FILE.png",
                "of a film: first image, motion and proposed crop; NAME_inspected.png here if left out",
            ),
            CONFIGURATION,
        ),
        example="lagsplat inspect pendulum.mp4",
    ),
    "fit": Verb(
        summary="Fit image model, chart and dynamics to one recording, in one process.",
        usage=("out=FOLDER [key=value ...]",),
        keys=(("out=FOLDER", "where the artefacts are written; required"), CONFIGURATION),
        example="lagsplat fit out=run profile=quick recording=filmed recording.path=arm.npz",
    ),
    "simulate": Verb(
        summary="Simulate a fitted run, or a simulator with its diagnosed effects.",
        usage=(
            "run=FOLDER out=q.csv [input=u.csv | seconds=10] [frame=N]",
            "run=OUT/augmented.safetensors out=q.csv [input=u.csv | seconds=10] "
            "[initial=q0,..,v0,.. | initial=state.csv] [input_hold=linear|zoh]",
        ),
        keys=(
            ("run=FOLDER|FILE", "a fitted run, or the augmented.safetensors of a diagnosis; required"),
            ("out=FILE", "CSV with columns t [s], q0, ... (whitened for a run) and v0, ... [1/s]; required"),
            ("input=FILE", "CSV with columns t [s] and u0, u1, ..., interpolated between its rows; for an"),
            ("", "augmented simulator also f0, f1, ...: pushes, as the accelerations they would give"),
            ("seconds=10", "duration without inputs [s]"),
            ("frame=N", "start from the state of this frame; from rest if left out"),
            ("initial=...", "start of an augmented simulator: numbers q0,..,v0,.. or a CSV"),
            ("input_hold=...", "linear or zoh, between two samples of the input"),
        ),
        example="lagsplat simulate run=run out=q.csv input=pressures.csv",
    ),
    "diagnose": Verb(
        summary="Name the physical effects by which a real mechanism differs from its simulator.",
        usage=("sim=SIM real=FILES [out=FOLDER] [diagnose.key=value ...]",),
        keys=(
            (
                "sim=SIM",
                "trajectories, a fitted run, a film, a MuJoCo .xml, a .urdf, or file.py:attribute; required.",
            ),
            ("", "A run is fitted to a film first, at profile quick, and kept: minutes to an hour, once."),
            ("", "A .py file runs as a program of yours: name none that you would not run"),
            (
                "real=FILES",
                "trajectories (CSV, Parquet, NPZ, MAT, HDF5, MCAP, ROS 2 bags), a LeRobot dataset or a",
            ),
            ("", "recording; held_out for a run's own; required"),
            ("out=FOLDER", "where report.html and diagnosis.json are written; diagnosis if left out"),
            ("diagnose.KEY=VALUE", "settings of conf/diagnose, such as diagnose.film_d=2: two coordinates"),
        ),
        example="lagsplat diagnose sim=model.xml real=log.csv out=diagnosis",
    ),
    "apply": Verb(
        summary="Add the effects of a diagnosis to a simulator.",
        usage=("diagnosis=OUT/diagnosis.json out=augmented.safetensors [sim=SIM]",),
        keys=(
            ("diagnosis=FILE", "the diagnosis.json; required"),
            ("out=FILE", "the augmented simulator; required"),
            ("sim=SIM", "a MuJoCo .xml or .urdf, file.py:attribute or a run; the diagnosed sim if left out"),
            ("diagnose.joints=...", "joints of the MuJoCo model, in order: [a,b]"),
            ("diagnose.actuators=...", "its actuators, in order: [a,b]"),
            ("diagnose.parameters=FILE", "YAML of mujoco.sysid whose values replace the MuJoCo model's"),
        ),
        example="lagsplat apply diagnosis=diagnosis/diagnosis.json out=augmented.safetensors",
    ),
    "evaluate": Verb(
        summary="Score a fitted run on the held-out part of its recording.",
        usage=("run=FOLDER out=metrics.json [evaluate.key=value ...]",),
        keys=(
            ("run=FOLDER", "a fitted run; required"),
            ("out=FILE", "where the scores are written; required"),
            ("evaluate.KEY=VALUE", "settings of conf/evaluate that differ from the run's"),
        ),
        example="lagsplat evaluate run=run out=metrics.json evaluate.starts=20",
    ),
    "view": Verb(
        summary="Push a fitted run in the browser.",
        usage=(
            "PAGE.html [--no-browser]",
            "FOLDER [--no-browser] [diagnosis=FOLDER] [replay=session.mcap] [out=FOLDER] "
            "[viewer.key=value ...]",
        ),
        keys=(
            ("diagnosis=FOLDER", "a diagnosis whose residual can be drawn over the image"),
            ("replay=FILE", "a saved session to begin with"),
            ("out=FOLDER", "where sessions are saved; the run's folder if left out"),
            ("viewer.KEY=VALUE", "settings of conf/viewer, such as viewer.port=8080"),
            ("forces.KEY=VALUE", "settings of conf/forces, such as forces.brush=0.1"),
        ),
        flags=(("--no-browser", "serve the page without opening a browser"),),
        example="lagsplat view run viewer.port=8081",
    ),
    "export": Verb(
        summary="Write a fitted run as a page, a log or Gaussians, or a diagnosis for mujoco.sysid.",
        usage=(
            "FOLDER --html [out=run.html]",
            "FOLDER --mcap [out=run.mcap] [key=value ...]",
            "FOLDER --ply [out=run.ply] [frame=N | q=0.5,..]",
            "DIAGNOSIS --sysid [out=FOLDER]",
        ),
        keys=(
            ("out=FILE", "what is written; run.html, run.mcap, run.ply or sysid in the folder if left out"),
            ("frame=N", "with --ply: the state of this frame; the rest state if left out"),
            ("q=Q0,Q1,...", "with --ply: this whitened state"),
            ("KEY=VALUE", "with --mcap evaluate.KEY, with --html any key of conf/"),
        ),
        flags=(
            ("--html", "one page that is pushed without a server"),
            ("--mcap", "a log with images and states"),
            ("--ply", "one state, for viewers of Gaussians"),
            (
                "--sysid",
                "recordings and changed parameters of a diagnosis, for MuJoCo's identification toolbox",
            ),
        ),
        example="lagsplat export run --html out=run.html",
    ),
    "weights": Verb(
        summary="Download the published weights of the baselines.",
        usage=("--download [out=FOLDER]",),
        keys=(("out=FOLDER", "where they are kept, for baseline.weights=FOLDER"),),
        flags=(("--download", "fetch them; without it only their terms are printed"),),
        example="lagsplat weights --download out=weights",
    ),
}


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command; returns the exit code."""
    words = list(sys.argv[1:] if arguments is None else arguments)
    verb = words[0] if words else "--help"
    try:
        if verb not in VERBS:
            return _run_without_verb(words or ["--help"])
        given = verb_parser(verb).parse_intermixed_args(words[1:])
        given.text = " ".join(["lagsplat", *words])
        logging.basicConfig(level=logging.INFO, format="%(message)s", stream=sys.stderr)
        from lagsplat.provenance import let_waiting_threads_sleep

        let_waiting_threads_sleep()
        from lagsplat.cli import verbs

        getattr(verbs, verb)(given)
    except (ValueError, OSError) as error:
        print(f"lagsplat {verb}: {error}", file=sys.stderr)
        return 2
    except SystemExit as done:  # argparse has printed help or the version
        return int(done.code or 0)
    return 0


def split_words(
    words: list[str],
    *,
    needed: tuple[str, ...] = (),
    allowed: tuple[str, ...] = (),
    settings: tuple[str, ...] = ("",),
) -> tuple[dict[str, str], list[str]]:
    """The values of a verb's own keys, and the words left over: overrides of the configuration.

    Every override must begin with one of ``settings``.

    Raises:
        CommandError: a needed key is missing or empty, or an override is of something else.
    """
    pairs = [(word, *word.partition("=")[::2]) for word in words]
    values = {key: value for _, key, value in pairs if key in (*needed, *allowed)}
    overrides = [word for word, key, _ in pairs if key not in (*needed, *allowed)]
    if missing := [key for key in needed if not values.get(key)]:
        raise CommandError(f"{missing[0]}=... is missing")
    if others := [word for word in overrides if not word.startswith(settings)]:
        known = ", ".join([*needed, *allowed, *(f"{prefix}key" for prefix in settings)])
        raise CommandError(f"takes {known}, not {others[0]!r}: other settings have no effect here")
    return values, overrides


class _Parser(argparse.ArgumentParser):
    """A parser whose errors are exceptions, so that all refusals of the command line look the same."""

    def error(self, message: str) -> NoReturn:
        raise CommandError(f"{message}; see {self.prog} --help\nusage: {self.usage}")


def verb_parser(name: str, parser: argparse.ArgumentParser | None = None) -> argparse.ArgumentParser:
    """The parser of one verb, or ``parser`` with its arguments added."""
    verb = VERBS[name]
    if parser is None:
        parser = _Parser()
    parser.prog = f"lagsplat {name}"
    parser.formatter_class = argparse.RawDescriptionHelpFormatter
    parser.usage = "\n       ".join(f"lagsplat {name} {text}" for text in verb.usage)
    parser.description = verb.summary
    width = max(len(key) for key, _ in verb.keys) + 2
    keys = "\n".join(f"  {key:<{width}}{text}" for key, text in verb.keys)
    parser.epilog = f"keys:\n{keys}\n\nexample:\n  {verb.example}\n\n{EXIT_CODES}"
    text = "FILE, FOLDER or key=value; see keys"
    words: Any = parser.add_argument("words", nargs="*", metavar="WORD", help=text)
    words.complete = {"bash": "_shtab_compgen_files", "zsh": "_files", "tcsh": "f"}
    for flag, text in verb.flags:
        parser.add_argument(flag, action="store_true", help=text)
    return parser


def _run_without_verb(words: list[str]) -> int:
    """Print the help, the version or the completion of a shell."""
    if words[0] == "help":
        words = ["--help"]
    if not words[0].startswith("-"):
        from difflib import get_close_matches

        near = get_close_matches(words[0], list(VERBS), n=1)
        hint = f" (did you mean {near[0]!r}?)" if near else ""
        raise CommandError(f"no such verb{hint}; choose {', '.join(VERBS)}")
    calls = "\n".join(f"  lagsplat {name} {text}" for name, verb in VERBS.items() for text in verb.usage)
    parser = _Parser(
        prog="lagsplat",
        usage="lagsplat VERB [key=value ...]",
        description="From one fixed-camera video to a simulation that can be pushed, and why it differs "
        "from the real mechanism.",
        epilog=f"usage of each verb:\n{calls}\n\n`lagsplat VERB --help` explains its keys.\n\n{EXIT_CODES}",
        formatter_class=argparse.RawDescriptionHelpFormatter,
    )
    parser.add_argument("--version", action="store_true", help="print the version")
    shells, text = ("bash", "zsh", "tcsh"), "print a completion script for this shell"
    parser.add_argument("--print-completion", choices=shells, help=text)
    verbs = parser.add_subparsers(dest="verb", title="verbs", metavar="VERB")
    for name, verb in VERBS.items():
        verb_parser(name, verbs.add_parser(name, help=verb.summary))
    given = parser.parse_args(words)
    if given.version:
        from lagsplat import __version__

        print(f"lagsplat {__version__}")
    if given.print_completion:
        import shtab

        print(shtab.complete(parser, shell=given.print_completion))
    return 0
