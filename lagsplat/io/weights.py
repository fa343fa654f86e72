"""Lists of weights that other programs saved with torch, read without running anything in them."""

import os
import pickle
import zipfile
from pathlib import Path
from typing import Any

import torch


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
