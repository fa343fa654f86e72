"""From the tensors of an artefact back to the module that they are the weights of."""

import os
from collections.abc import Mapping
from typing import TypeVar

import numpy as np
import torch

M = TypeVar("M", bound=torch.nn.Module)


def restore(module: M, tensors: Mapping[str, np.ndarray], path: str | os.PathLike[str]) -> M:
    """``module`` with the ``tensors`` read from ``path`` as its weights, ready to be asked.

    Raises:
        ValueError: the tensors are not those of this module.
    """
    try:
        module.load_state_dict({name: torch.as_tensor(np.array(value)) for name, value in tensors.items()})
    except RuntimeError as error:
        first = str(error).splitlines()[-1].strip()
        raise ValueError(
            f"{path}: weights of another layout ({first}); the file was made by other code. Delete it and "
            "make it again"
        ) from error
    return module.eval()
