"""Training state on disk: enough to go on after a kill as if nothing had happened.

A checkpoint is not an artefact. It belongs to one run, is named by the run's identity (a digest of what
decides its outcome) and is deleted when the run has ended.

Lists of weights that other programs saved with torch, read without running anything in them.
"""

import logging
import os
import pickle
import zipfile
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import torch

log = logging.getLogger(__name__)


P = TypeVar("P", bound=tuple[Any, ...])  # a row of a training curve, which begins with the steps done


def save_training_state(
    path: Path,
    model: torch.nn.Module,
    optimizer: torch.optim.Optimizer,
    curve: Sequence[P],
    *,
    identity: str,
) -> None:
    """Write the state of a training at the last point of its curve."""
    state = {
        "model": model.state_dict(),
        "optimizer": optimizer.state_dict(),
        "curve": [tuple(point) for point in curve],
    }
    save_checkpoint(path, state, identity=identity)


def load_training_state(
    path: Path | None,
    model: torch.nn.Module,
    optimizer: torch.optim.Optimizer,
    point: Callable[..., P],
    *,
    identity: str,
) -> tuple[int, list[P]]:
    """Put back what :func:`save_training_state` wrote, if it did; the steps done and the curve so far."""
    state = load_checkpoint(path, identity=identity) if path else None
    if state is None:
        return 0, []
    model.load_state_dict(state["model"])
    optimizer.load_state_dict(state["optimizer"])
    curve = [point(*row) for row in state["curve"]]
    log.info("going on from %s at step %d", path, curve[-1][0])
    return curve[-1][0], curve


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


def load_weights(path: str | os.PathLike[str]) -> dict[str, Any]:
    """What a ``.pt`` file holds: plain numbers, texts, dictionaries and tensors, on the CPU.

    Raises:
        FileNotFoundError: nothing is at ``path``.
        ValueError: the file is damaged, holds objects that would have to be run, or no dictionary.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(f"{path}: no such file; check the path")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except (
        pickle.UnpicklingError,
        RuntimeError,
        EOFError,
        zipfile.BadZipFile,
        ValueError,
        KeyError,
    ) as error:
        reason = str(error).splitlines()[0]
        raise ValueError(
            f"{path}: not a list of weights that can be read without running code in it ({reason}); fetch it "
            "again, or save it as a dictionary of tensors"
        ) from error
    if not isinstance(content, dict):
        raise ValueError(
            f"{path}: holds a {type(content).__name__}, but a dictionary of weights is wanted; check which "
            "file was given"
        )
    return content
