"""Score a fitted run under the protocol it was made with."""

from collections.abc import Sequence
from pathlib import Path
from typing import Any

from omegaconf import OmegaConf

from lagsplat.config.compose import ConfigError, rebuild
from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.evaluate import evaluate
from lagsplat.io.files.json_files import load_json
from lagsplat.runs.run import FittedRun, locate_artefact
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


def evaluate_run(run: FittedRun, config: EvaluateConfig) -> dict[str, Any]:
    """Every score of a run under a protocol."""
    return evaluate(run.autoencoder, run.chart, run.lagrangian, run.recording, config)
