"""Training state on disk, and weights that other programs saved with torch.

A checkpoint belongs to one run, carries the run's identity (a digest of what determines its result) and is
deleted when the run ends. A resumed run continues exactly as if uninterrupted.
"""

import io
import logging
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any, TypeVar

import torch
import xxhash
from torch.nn import Module
from torch.optim import Optimizer

from lagsplat.io.files.atomic import StrPath, replace_atomically

DIGEST_BYTES = 8  # of XXH3, at the end of the file
log = logging.getLogger(__name__)


P = TypeVar("P", bound=tuple[Any, ...])  # a row of a training curve; the first field is the step


def save_training_state(
    path: Path | None, model: Module, optimizer: Optimizer, curve: Sequence[P], *, identity: str
) -> None:
    """Write the state of a training run at the last point of its curve; no path, no file."""
    points = [tuple(point) for point in curve]
    state = {"model": model.state_dict(), "optimizer": optimizer.state_dict(), "curve": points}
    if path is not None:
        save_checkpoint(path, state, identity=identity)


def load_training_state(
    path: Path | None, model: Module, optimizer: Optimizer, point: Callable[..., P], *, identity: str
) -> list[P]:
    """Restore the state from :func:`save_training_state` if there is one; return the curve so far."""
    state = load_checkpoint(path, identity=identity) if path else None
    if state is None:
        return []
    model.load_state_dict(state["model"])
    optimizer.load_state_dict(state["optimizer"])
    curve = [point(*row) for row in state["curve"]]
    log.info("going on from %s at step %d", path, curve[-1][0])
    return curve


def save_checkpoint(path: Path, state: dict[str, Any], *, identity: str) -> None:
    """Write ``state`` atomically: a kill leaves either the old checkpoint or the new one."""
    buffer = io.BytesIO()
    torch.save({"identity": identity, "state": state}, buffer)
    content = buffer.getvalue()
    with replace_atomically(path) as temporary:
        # torch does not compare the checksums in its own format, and reads past what follows its end.
        temporary.write_bytes(content + xxhash.xxh3_64_digest(content))


def load_checkpoint(path: Path, *, identity: str) -> dict[str, Any] | None:
    """Load the state to resume from, or None if there is none of this run.

    A checkpoint of another identity (other settings, code or recording) or a damaged one is ignored with a
    message; the next save replaces it.
    """
    if not path.exists():
        return None
    try:
        content = torch.load(io.BytesIO(_checked(path)), map_location="cpu", weights_only=True)
    except Exception as error:
        log.warning("%s cannot be read (%s); training starts from the beginning", path, error)
        return None
    if content["identity"] != identity:
        log.warning("%s belongs to other settings, code or data; training starts from the beginning", path)
        return None
    return content["state"]


def _checked(path: Path) -> bytes:
    content = path.read_bytes()
    content, digest = content[:-DIGEST_BYTES], content[-DIGEST_BYTES:]
    if xxhash.xxh3_64_digest(content) != digest:
        raise ValueError("its checksum differs: it was damaged on the disk, or other code wrote it")
    return content


def load_weights(path: StrPath) -> dict[str, Any]:
    """Load a ``.pt`` file without running code: numbers, text, dictionaries and tensors, on the CPU.

    Raises:
        FileNotFoundError: there is no file at ``path``.
        ValueError: the file is damaged, needs code to be run, or holds no dictionary.
    """
    if not Path(path).is_file():
        raise FileNotFoundError(f"{path}: no such file; check the path")
    try:
        content = torch.load(path, map_location="cpu", weights_only=True)
    except Exception as error:  # of pickle, zip, torch or safetensors
        reason = str(error).splitlines()[0]
        raise ValueError(
            f"{path}: not a list of weights that can be read without running code in it ({reason}); fetch it "
            "again, or save it as a dictionary of tensors"
        ) from error
    if not isinstance(content, dict):
        raise ValueError(
            f"{path}: holds a {type(content).__name__}, no dictionary of weights; check its name"
        )
    return content
