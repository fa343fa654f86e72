"""A baseline for a recording: trained on it, or with weights that were published."""

from pathlib import Path
from typing import Any

from lagsplat.baselines.config import BaselineConfig
from lagsplat.baselines.fit import fit_baseline
from lagsplat.baselines.model import Baseline
from lagsplat.baselines.released import load_released
from lagsplat.io.recording import Recording


def obtain_baseline(
    train: Recording, config: BaselineConfig, *, seed: int, checkpoint: Path, identity: str
) -> tuple[Baseline, dict[str, Any]]:
    """The model and the story of its training, for its header; arguments as `fit_baseline`.

    The story has ``steps``, ``frames_seen`` and ``wall_s``, None where they were not spent here, ``weights``
    (the file, or None), ``epoch`` of published weights, and ``curve``, a list of rows.

    Raises:
        ValueError, FloatingPointError: as `fit_baseline` and `lagsplat.baselines.released.load_released`;
            also weights of another model than the one configured.
    """
    if config.weights is None:
        baseline, curve = fit_baseline(train, config, seed=seed, checkpoint=checkpoint, identity=identity)
        rows = [point._asdict() for point in curve]
        spent = {"steps": config.n_steps, "frames_seen": config.n_steps * config.batch}
        return baseline, {**spent, "wall_s": curve[-1].seconds, "weights": None, "epoch": None, "curve": rows}
    baseline, epoch = load_released(config.weights)
    found, wanted = baseline.architecture, (config.decoder, config.dynamics)
    if (found.decoder, found.dynamics) != wanted:
        raise ValueError(
            f"{config.weights}: holds {found.dynamics} with {found.decoder}, but {wanted[1]} with "
            f"{wanted[0]} are wanted; choose with baselines=[...], or give a folder with SYSTEM/BASELINE.pt"
        )
    unknown = dict.fromkeys(("steps", "frames_seen", "wall_s"))
    return baseline, {**unknown, "weights": str(config.weights), "epoch": epoch, "curve": []}
