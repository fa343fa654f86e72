"""``rollouts.csv``: every held-out block, measured and forecast twice, so that anybody can score it again."""

import os
from collections.abc import Sequence

import numpy as np
import pandas as pd

from lagsplat.diagnose.result import Block
from lagsplat.io.atomic import replacing

KINDS = ("real", "sim", "augmented")


def rollouts_table(blocks: Sequence[Block], *, q_names: Sequence[str] = ()) -> pd.DataFrame:
    """Columns ``file, block, t``, then every coordinate as measured, of the sim and of the sim with effects.

    ``t`` is the recording's own clock [s]. Names default to ``q0, q1, ...``.

    Raises:
        ValueError: blocks or names of different numbers of coordinates.
    """
    widths = {block.real.shape[1] for block in blocks} | ({len(q_names)} if q_names else set())
    if len(widths) > 1:
        raise ValueError(f"rollouts of {sorted(widths)} coordinates; all blocks and names must have as many")
    names = tuple(q_names) or tuple(f"q{i}" for i in range(max(widths, default=1)))
    columns = ["file", "block", "t", *(f"{name}_{kind}" for kind in KINDS for name in names)]
    parts = []
    for block in blocks:
        paths = np.concatenate([getattr(block, kind) for kind in KINDS], axis=1)
        part = pd.DataFrame(paths, columns=columns[3:])
        part.insert(0, "t", block.time_s)
        part.insert(0, "block", block.index)
        part.insert(0, "file", block.file)
        parts.append(part)
    return pd.concat(parts, ignore_index=True) if parts else pd.DataFrame(columns=columns)


def save_rollouts(
    path: str | os.PathLike[str], blocks: Sequence[Block], *, q_names: Sequence[str] = ()
) -> None:
    """Write `rollouts_table` in full precision, whole or not at all."""
    table = rollouts_table(blocks, q_names=q_names)
    with replacing(path) as temporary:
        table.to_csv(temporary, index=False)


def load_rollouts(path: str | os.PathLike[str]) -> tuple[tuple[Block, ...], tuple[str, ...]]:
    """The blocks of a file and the names of their coordinates.

    Raises:
        ValueError: the columns are not those of rollouts.
    """
    table = pd.read_csv(path, dtype={"file": str})
    names = tuple(str(name).removesuffix("_real") for name in table.columns if str(name).endswith("_real"))
    wanted = ["file", "block", "t", *(f"{name}_{kind}" for kind in KINDS for name in names)]
    if list(table.columns) != wanted or not names:
        raise ValueError(
            f"{os.fspath(path)} has columns {list(table.columns)}; rollouts have "
            "file, block, t, then q*_real, q*_sim and q*_augmented of the same coordinates"
        )
    blocks = []
    for (file, index), part in table.groupby(["file", "block"], sort=False):
        real, sim, augmented = (
            part[[f"{name}_{kind}" for name in names]].to_numpy(dtype=np.float64) for kind in KINDS
        )
        time_s = part["t"].to_numpy(dtype=np.float64)
        blocks.append(Block(str(file), int(str(index)), time_s, real, sim, augmented))
    return tuple(blocks), names
