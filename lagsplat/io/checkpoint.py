"""Training state on disk: enough to go on after a kill as if nothing had happened.

A checkpoint is not an artefact. It belongs to one run, is named by the run's identity (a digest of what
decides its outcome) and is deleted when the run has ended.
"""

import logging
import os
from pathlib import Path
from typing import Any

import torch

log = logging.getLogger(__name__)


def save_checkpoint(path: Path, state: dict[str, Any], *, identity: str) -> None:
    """Write ``state`` so that a kill at any moment leaves either the old checkpoint or the new one."""
    path.parent.mkdir(parents=True, exist_ok=True)
    partial = path.with_suffix(".partial")
    with partial.open("wb") as file:
        torch.save({"identity": identity, "state": state}, file)
        file.flush()
        os.fsync(file.fileno())
    os.replace(partial, path)


def load_checkpoint(path: Path, *, identity: str) -> dict[str, Any] | None:
    """The state to go on from, or None where there is none that belongs to this run.

    A checkpoint of another identity (other settings, code or recording) or a damaged one is left where it is
    and said to be ignored; the next save replaces it.
    """
    if not path.exists():
        return None
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:
        log.warning("%s cannot be read (%s); training starts from the beginning", path, error)
        return None
    if content["identity"] != identity:
        log.warning("%s belongs to other settings, code or data; training starts from the beginning", path)
        return None
    return content["state"]
