"""Score a fitted run under the protocol it was made with."""

import os
from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from lagsplat.config.compose import ConfigError, rebuild
from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.evaluate import evaluate as evaluate_models
from lagsplat.io.files.atomic import load_json
from lagsplat.runs.run import FittedRun, locate_artefact, open_run
from lagsplat.stage2.fit import load_dynamics


def read_protocol(folder: Path, changes: Sequence[str] = ()) -> EvaluateConfig:
    """How the run in ``folder`` is scored: by its own settings, with changes such as ``evaluate.starts=20``.

    They stand in the dynamics that `fit` writes, and beside the scores that the workflow makes.

    Raises:
        FileNotFoundError: the folder holds neither.
        ConfigError: a change is of something else than ``evaluate``, or unknown.
    """
    if other := [change for change in changes if not change.startswith("evaluate.")]:
        raise ConfigError(f"{other[0]!r}: a run keeps its settings; only evaluate.KEY=VALUE can be changed")
    _, header = load_dynamics(locate_artefact(folder, "dynamics"))
    record = folder / "evaluate.json"
    if "config" in header:
        own = header["config"]["evaluate"]
    elif record.is_file():
        own = load_json(record)["settings"]["cfg"]
    else:
        raise FileNotFoundError(f"{folder}: no evaluate.json says how this run is scored; evaluate it first")
    changed = OmegaConf.from_dotlist([change.removeprefix("evaluate.") for change in changes])
    return rebuild(EvaluateConfig, OmegaConf.to_container(OmegaConf.merge(own, changed)))  # type: ignore[arg-type]


def evaluate(run: FittedRun | str | os.PathLike[str], *overrides: str) -> dict[str, Any]:
    """Score a run on the held-out part of its recording, under the protocol it was made with.

    Args:
        run: A fitted run from a folder, or the folder.
        overrides: Changes of the protocol, such as ``"evaluate.starts=20"``.

    Returns:
        Scores by name, and the curves behind them; errors are mean squares of images in [0, 1] or fractions.

    Raises:
        FileNotFoundError: nothing says how the run is scored.
        ValueError: a change of something else than the protocol, or a run that was never in a folder.

    Example:
        >>> import lagsplat
        >>> scores = lagsplat.evaluate("run", "evaluate.starts=2")["scores"]
        >>> 0 < scores["ae_floor"] < 1
        True
    """
    run = run if isinstance(run, FittedRun) else open_run(run)
    if run.folder is None:
        raise ValueError("this run has no folder, which holds how it is scored; open it with open_run")
    protocol = read_protocol(run.folder, overrides)
    return evaluate_models(run.autoencoder, run.chart, run.lagrangian, run.recording, protocol)
