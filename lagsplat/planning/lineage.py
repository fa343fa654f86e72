"""What lies behind a job: a digest of the settings and code of every stage before it."""

import hashlib
from pathlib import Path

from lagsplat.config.schema import Config
from lagsplat.planning.plan import Overrides, compose_for, script_digest

Road = dict[str, tuple[object, str]]
"""Settings and script of each stage, in order."""


def lineage(overrides: Overrides, scripts: Path, stage: str, **choices: str) -> str:
    """Digest of the settings and code of every stage before ``stage``, for the job that ``choices`` name.

    A job carries it because Snakemake compares a job's own settings only: after a stage has failed under new
    settings, it would take the earlier results further down for up to date.
    """
    experiment = compose_for(overrides, **choices)
    road = road_to(stage, experiment)
    before = list(road.values())[: list(road).index(stage)]
    text = "\n".join(
        f"{settings} {script_digest(next(scripts.rglob(f'{script}.py')))}" for settings, script in before
    )
    return hashlib.sha256(f"{experiment.recording.split} {text}".encode()).hexdigest()


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
    branch = stage.partition("_")[0]
    if branch not in _BRANCHES:
        return trunk
    leaves, scripts = _BRANCHES[branch]
    settings = {
        "baseline": (experiment.baseline, experiment.evaluate),
        "forecaster": (experiment.forecaster, experiment.extrapolation),
        "ode": (experiment.ode, experiment.extrapolation),
        "authors": (experiment.authors, experiment.extrapolation),
        "extrapolate": (experiment.extrapolation,),
        "field": (experiment.deformation, None),
    }[branch]
    road = {name: trunk[name] for name in leaves}
    for name, script, used in zip(_names(branch, len(scripts)), scripts, (*settings, None), strict=True):
        road[name] = (used, script)
    return road


_BRANCHES = {
    "baseline": (("recording",), ("baseline", "baseline_evaluate", "table")),
    "forecaster": (("recording",), ("forecaster", "extrapolate_forecaster", "extrapolation")),
    "ode": (("recording", "stage1", "chart"), ("ode", "extrapolate_ode", "extrapolation")),
    "authors": (("recording",), ("authors", "extrapolate_authors", "extrapolation")),
    "extrapolate": (("recording", "stage1", "chart", "stage2"), ("extrapolate", "extrapolation")),
    "field": (("recording", "stage1", "chart"), ("field", "velocity_field", "deformation")),
}
"""Where each branch leaves the trunk, and its scripts."""


def _names(branch: str, count: int) -> list[str]:
    """Stages of a branch: itself, how it is read where that is a job of its own, and its table."""
    read = "evaluate" if branch == "baseline" else "read"
    return [branch, f"{branch}_{read}", f"{branch}_table"] if count == 3 else [branch, f"{branch}_table"]
