"""Which runs a command asks for, and the digest of everything a job depends on.

A wildcard of a path is an identity: the name of a file in ``conf/`` or a seed. It wins over the command line,
so that a path never holds another system's result. No torch is loaded, so that planning stays fast.
"""

import shlex
from collections.abc import Mapping
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

from lagsplat.config.compose import ConfigError, closest, compose, key_of
from lagsplat.config.schema import Config, options
from lagsplat.io.config import RecordingConfig
from lagsplat.io.video.clips import find_clips
from lagsplat.provenance import code_digest, modules_in, parse_source, sha256_hex

MASSES = ("networks", "induced_mass", "constant_mass")  # learned, induced, constant
"""Choices of ``conf/stage2`` that differ from each other in the form of the mass alone."""
RECIPES = (("default", "networks"), ("paper", "paper"), ("upstream", "upstream"))
"""Choices of ``conf/stage1`` and ``conf/stage2`` that are compared with the chosen ones."""


@dataclass(frozen=True)
class Overrides:
    """What the user changed: for every system, and for one system alone."""

    shared: tuple[str, ...]
    of_system: Mapping[str, tuple[str, ...]]


@dataclass(frozen=True)
class PlannedRun:
    """Identity of one trained simulation: the wildcards of its path."""

    profile: str
    recording: str
    system: str
    stage1: str
    ae: int
    stage2: str
    seed: int


@dataclass(frozen=True)
class PlannedBaseline:
    """Identity of one baseline on one recording: the wildcards of its path."""

    profile: str
    recording: str
    system: str
    baseline: str
    seed: int


@dataclass(frozen=True)
class PlannedForecast(PlannedRun):
    """Identity of one forecaster or free differential equation: the wildcards of its path.

    ``model`` is a choice of ``conf/forecaster``, of ``conf/ode`` or of `TRIVIAL`, as ``kind`` says; ``trial``
    is its seed. It is read in the chart of the system's first run, whose wildcards are the others.
    """

    kind: str
    model: str
    trial: int


def read_overrides(command_line: Mapping[str, Any]) -> Overrides:
    """Overrides given to Snakemake as ``--config hydra="..." hydra_<system>="..."``.

    Words are split as a shell would, so that a path with a blank can be quoted.

    Raises:
        ConfigError: another key, an unknown system, or ``system=`` (the path of the target names it).
    """
    of_key: dict[str, tuple[str, ...]] = {}
    known = ["hydra", *(f"hydra_{name}" for name in options("system"))]
    for key, text in command_line.items():
        try:
            of_key[key] = tuple(shlex.split(str(text or "")))
        except ValueError as error:
            raise ConfigError(
                f"--config {key}={text!r}: {error}. Snakemake drops a quote at either end: "
                "put another override there"
            ) from error
        if bad := [word for word in of_key[key] if key_of(word) == "system"]:
            raise ConfigError(f"{key}: {bad[0]} has no effect here; choose systems with systems=[...]")
        if key not in known:
            raise ConfigError(f"--config {key}: no such key{closest(key, known)}; known: {', '.join(known)}")
    shared = of_key.pop("hydra", ())
    return Overrides(shared, {key.removeprefix("hydra_"): words for key, words in of_key.items()})


def compose_for(overrides: Overrides, **choices: str) -> Config:
    """The experiment of one job: the user's overrides first, then the choices its path makes."""
    own = overrides.of_system.get(choices.get("system", ""), ())
    shared = (*overrides.shared, *own)
    if "system" in choices:
        # A path repeats what is chosen anyway. Without it, all the jobs of one run share one composition.
        shared = (*shared, f"system={choices['system']}")
        usual = compose(*shared).choices
        choices = {group: name for group, name in choices.items() if usual.get(group) != name}
    return compose(*shared, *(f"{group}={name}" for group, name in sorted(choices.items())))


def shared_experiment(overrides: Overrides) -> Config:
    """What holds for all systems; as the first one has it where it makes no sense without a system.

    A crop, for one, suits films alone, and what is composed for no system in particular is an arm.
    """
    try:
        return compose(*overrides.shared)
    except ConfigError:
        chosen = [item for item in overrides.shared if key_of(item) in ("systems", "profile")]
        return compose_for(overrides, system=compose(*chosen).systems[0])


def _runs_of(experiment: Config, stage2: str) -> list[PlannedRun]:
    """A run of one system's experiment for each seed, of stage 1 and stage 2 alike."""
    chosen = experiment.choices
    place = (chosen["profile"], chosen["recording"], chosen["system"], chosen["stage1"])
    return [PlannedRun(*place, seed, stage2, seed) for seed in experiment.seeds]


def _unless_left_out(overrides: Overrides, key: str, names: list[str]) -> list[str]:
    """The systems ``key=names``; only those in ``systems`` where a user chooses these, and not ``key``."""
    chosen = {key_of(item) for item in overrides.shared}
    if "systems" not in chosen or key in chosen:
        return names
    return [name for name in names if name in shared_experiment(overrides).systems]


def planned_runs(overrides: Overrides) -> list[PlannedRun]:
    """Every run behind the tables and figures, each composed, hence checked, before anything is trained.

    Raises:
        ConfigError: see `lagsplat.config.compose.compose`; also a recording that is not there, or one file
            for several systems.
    """
    experiment = shared_experiment(overrides)
    for system in overrides.of_system:
        compose_for(overrides, system=system)
    files: dict[str, str] = {}
    runs = []
    for system in experiment.systems:
        own = compose_for(overrides, system=system)
        _check_file(own.recording, system, files, meant=system in overrides.of_system)
        for stage2 in dict.fromkeys([own.choices["stage2"], *own.ablations]):
            compose_for(overrides, system=system, stage2=stage2)
            runs += _runs_of(own, stage2)
    return runs


def planned_masses(overrides: Overrides) -> list[PlannedRun]:
    """Every run behind the table of mass ablations: the arms, with networks and `MASSES`."""
    runs = []
    for run in planned_runs(overrides):
        own = compose_for(overrides, system=run.system)
        if own.system.film_kind == "krauss" and run.stage2 == own.choices["stage2"]:
            runs += [replace(run, stage2=name) for name in MASSES]
    for run in runs:
        compose_for(overrides, system=run.system, stage2=run.stage2)
    return runs


def planned_recipes(overrides: Overrides) -> list[PlannedRun]:
    """Every run behind the table of recipes: each system with the chosen settings and with `RECIPES`."""
    runs = []
    for system in shared_experiment(overrides).systems:
        own = compose_for(overrides, system=system)
        chosen = (own.choices["stage1"], own.choices["stage2"])
        for stage1, stage2 in dict.fromkeys([chosen, *RECIPES]):
            runs += _runs_of(compose_for(overrides, system=system, stage1=stage1, stage2=stage2), stage2)
    return runs


def planned_baselines(overrides: Overrides) -> list[PlannedBaseline]:
    """Every baseline of the benchmark table: on the recordings of the pneumatic arms, each composed.

    Raises:
        ConfigError: see `lagsplat.config.compose.compose`; also weights that are not there.
    """
    runs = []
    for system in shared_experiment(overrides).systems:
        own = compose_for(overrides, system=system)
        for name in dict.fromkeys(own.baselines if own.system.film_kind == "krauss" else ()):
            weights_of(overrides, system=system, baseline=name)
            place = (own.choices["profile"], own.choices["recording"], system, name)
            runs += [PlannedBaseline(*place, seed) for seed in own.baseline_seeds]
    return runs


def planned_extrapolations(overrides: Overrides) -> tuple[list[PlannedRun], list[PlannedForecast]]:
    """Every run of the table of extrapolation, and every forecaster read in the chart of its system's first.

    Raises:
        ConfigError: see `lagsplat.config.compose.compose`; also a system that is driven.
    """
    runs: list[PlannedRun] = []
    others: list[PlannedForecast] = []
    extrapolated = shared_experiment(overrides).extrapolated
    for system in _unless_left_out(overrides, "extrapolated", extrapolated):
        own = compose_for(overrides, system=system)
        if own.system.film_kind != "video":
            raise ConfigError(
                f"extrapolated={own.extrapolated}: {system} is driven by its inputs, which a forecaster of "
                "pictures does not know; choose systems that move freely"
            )
        mine = _runs_of(own, own.choices["stage2"])
        runs += mine
        models = [("forecaster", name) for name in dict.fromkeys(own.forecasters)]
        models += [("ode", name) for name in dict.fromkeys(own.odes)]
        if own.authors.checkout is not None or own.authors.frames is not None:
            models.append(("authors", own.choices["authors"]))
        models += [("trivial", name) for name in TRIVIAL]
        for kind, name in models:
            if kind != "trivial":
                compose_for(overrides, system=system, **{kind: name})
            trials = own.forecaster_seeds if kind in ("forecaster", "ode") else [0]
            others += [PlannedForecast(**asdict(mine[0]), kind=kind, model=name, trial=n) for n in trials]
    return runs, others


TRIVIAL = ("mean", "hold", "linear")  # laws beside every run that is extrapolated
SUFFIX = "_3d"
FIGURE_NAMES = {"rainbow_rocker": "rocker", "krauss_2seg": "krauss"}  # of systems whose name is long


def planned_spatial(overrides: Overrides) -> dict[str, PlannedRun]:
    """The run behind each figure in space, by the figure's name.

    Left out are systems whose simulated views do not suit a filmed recording, and, where a user chooses
    ``systems`` and not ``spatial``, all that are not among these.

    Raises:
        ConfigError: see `lagsplat.config.compose.compose`; also a system without novel views.
    """
    spatial = shared_experiment(overrides).spatial
    runs = {}
    for system in _unless_left_out(overrides, "spatial", spatial):
        own = compose_for(overrides, system=system)
        if own.views is None:
            raise ConfigError(
                f"spatial={spatial}: {system} has no novel views and its Gaussians live in the picture; give "
                f"it some, for instance hydra_{system}='views=sharp', or leave it out"
            )
        if own.views.kind != "simulated" or own.recording.kind == "simulated":
            name = system.removesuffix(SUFFIX)
            runs[FIGURE_NAMES.get(name, name)] = _runs_of(own, own.choices["stage2"])[0]
    return runs


def weights_of(overrides: Overrides, **choices: str) -> str | None:
    """The file of published weights that stands for a training, or None where there is a training.

    Raises:
        ConfigError: ``baseline.weights`` is neither that file nor a folder that holds it.
    """
    given = compose_for(overrides, **choices).baseline.weights
    if given is None:
        return None
    path = Path(given).expanduser()
    if path.is_dir():
        path = path / choices["system"] / f"{choices['baseline']}.pt"
    if not path.is_file():
        raise ConfigError(
            f"baseline.weights={given}: no file {path}; give a file for one baseline, or a folder with "
            "SYSTEM/BASELINE.pt as `lagsplat weights` makes it"
        )
    return str(path)


def files_of(overrides: Overrides, **choices: str) -> list[str]:
    """The user's files behind a filmed recording; none where it comes from a public archive.

    Raises:
        ConfigError: nothing is there, or a folder without a recording.
    """
    return _list_files(compose_for(overrides, **choices).recording)


def _list_files(recording: RecordingConfig) -> list[str]:
    if recording.path is None:
        return []
    if recording.kind == "lerobot":
        suffixes = (".json", ".jsonl", ".parquet", ".mp4")
        files = sorted(Path(recording.path).expanduser().rglob("*"))
        return [str(file) for file in files if file.suffix in suffixes] or [recording.path]
    if recording.kind not in ("video", "mcap"):
        return [str(Path(recording.path).expanduser())]
    try:
        return [str(file) for clip in find_clips(recording.path) for file in clip.files]
    except (OSError, ValueError) as error:
        raise ConfigError(f"recording.path={recording.path}: {error}") from error


def _check_file(recording: RecordingConfig, system: str, files: dict[str, str], *, meant: bool) -> None:
    """A file for all systems is a slip; one that a system was given by name may be another part of it."""
    if recording.kind == "simulated" or recording.path is None:
        return
    if not all(Path(file).is_file() for file in _list_files(recording)):
        raise ConfigError(f"recording.path={recording.path} ({system}): no such file; check the path")
    if recording.path in files and not meant:
        raise ConfigError(
            f"recording.path={recording.path} would serve {files[recording.path]} and {system}; choose one "
            f"with systems=[{system}], or give each its own with hydra_{system}='recording.path=...'"
        )
    files[recording.path] = system


def script_digest(script: Path, *commands: str) -> str:
    """SHA-256 of what a workflow script can execute: its own code and all of ``lagsplat`` that it imports,
    and the modules that it runs as ``commands``.

    Comments and docstrings do not count. Nor does ``lagsplat.planning.job``, the frame around a script: it
    decides where a result is logged, not what it is.
    """
    digest, imports = parse_source(script)
    modules = set(modules_in(imports)) - {"lagsplat.planning.job"}
    return sha256_hex((digest + code_digest(*sorted(modules), *commands)).encode())


def files_of_rig(path: str) -> list[str]:
    """The JSON that describes a rig, and the films of its cameras.

    Raises:
        ConfigError: a file is missing, or the JSON is not a rig.
    """
    from lagsplat.views.rig import read_rig  # NumPy, which the rest of planning does without

    try:
        rig = read_rig(path)
    except (OSError, ValueError) as error:
        raise ConfigError(f"views.rig={path}: {error}") from error
    return [str(Path(path).expanduser()), *(str(each.video) for each in rig.others)]


Road = dict[str, tuple[object, str]]  # settings and script of each stage, in order


def lineage(overrides: Overrides, scripts: Path, stage: str, **choices: str) -> str:
    """Digest of the settings and code of every stage before ``stage``, for the job that ``choices`` name.

    A job carries it because Snakemake compares a job's own settings only: after a stage has failed under new
    settings, it would take the earlier results further down for up to date.
    """
    experiment = compose_for(overrides, **choices)
    road = road_to(stage, experiment)
    before = list(road.values())[: list(road).index(stage)]
    steps = [(settings, next(scripts.rglob(f"{script}.py"))) for settings, script in before]
    text = "\n".join(f"{settings} {script_digest(path)}" for settings, path in steps)
    return sha256_hex(f"{experiment.recording.split} {text}".encode())


def road_to(stage: str, experiment: Config) -> Road:
    """The stages from the recording to the table or figure that ``stage`` lies on the way to.

    A stage's name begins with that of the branch it belongs to; those of the trunk have none.
    """
    maker = "simulate" if experiment.recording.kind == "simulated" else "ingest"
    source = (experiment.simulation, experiment.release) if maker == "simulate" else experiment.recording
    trunk: Road = {
        "recording": (source, maker),
        **({"views": (experiment.views, "views")} if experiment.views is not None else {}),
        "stage1": (experiment.stage1, "stage1"),
        "chart": (experiment.chart, "chart"),
        "stage2": (experiment.stage2, "stage2"),
        "evaluate": (experiment.evaluate, "evaluate"),
        "table": (None, "table"),
    }
    extrapolation = experiment.extrapolation
    branches: Road = {
        "baseline": (experiment.baseline, "baseline"),
        "baseline_evaluate": (experiment.evaluate, "baseline_evaluate"),
        "baseline_table": (None, "table"),
        "forecaster": (experiment.forecaster, "forecaster"),
        "forecaster_read": (extrapolation, "extrapolate_forecaster"),
        "forecaster_table": (None, "extrapolation"),
        "simple": (experiment.evaluate, "simple_predictors"),
        "simple_table": (None, "table"),
        "ode": (experiment.ode, "ode"),
        "ode_read": (extrapolation, "extrapolate_ode"),
        "ode_table": (None, "extrapolation"),
        "peer": (experiment.ode, "ode"),
        "peer_evaluate": (experiment.evaluate, "ode_evaluate"),
        "peer_table": (None, "table"),
        "trivial_read": (extrapolation, "extrapolate_trivially"),
        "trivial_table": (None, "extrapolation"),
        "authors": (experiment.authors, "authors"),
        "authors_read": (extrapolation, "extrapolate_authors"),
        "authors_table": (None, "extrapolation"),
        "extrapolate": (extrapolation, "extrapolate"),
        "extrapolate_table": (None, "extrapolation"),
        "matter": (experiment.matter, "matter"),
        "matter_paths": (None, "material_paths"),
        "planar": (experiment.deformation, "planar_decoder"),
        "planar_read": (None, "velocity_field"),
        "planar_table": (None, "deformation"),
    }
    branch = stage.partition("_")[0]
    if branch not in TRUNK_BEFORE:
        return trunk
    before = {name: step for name, step in trunk.items() if name in TRUNK_BEFORE[branch]}
    return before | {name: step for name, step in branches.items() if name.partition("_")[0] == branch}


TRUNK_BEFORE = {
    "baseline": ("recording",),
    "forecaster": ("recording",),
    "simple": ("recording", "views", "stage1", "chart"),
    "ode": ("recording", "stage1", "chart"),
    "peer": ("recording", "views", "stage1", "chart"),
    "trivial": ("recording", "stage1", "chart", "stage2"),
    "authors": ("recording",),
    "extrapolate": ("recording", "stage1", "chart", "stage2"),
    "planar": ("recording", "stage1", "chart"),
    "matter": ("recording", "views", "stage1", "chart"),
}
"""Stages of the trunk before each branch."""
