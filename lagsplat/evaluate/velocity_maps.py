"""Painted speeds and pictures of decoders, and their measures, in one file."""

import os
from collections.abc import Mapping
from typing import Any

import numpy as np

from lagsplat.io.artefact import load_artefact, save_artefact

KIND, SCHEMA = "velocity_maps", 1

Maps = dict[str, dict[str, np.ndarray]]


def save_maps(
    path: str | os.PathLike[str],
    maps: Mapping[str, Mapping[str, np.ndarray]],
    measures: Mapping[str, Mapping[str, Any]],
    header: Mapping[str, Any],
) -> None:
    """Write the maps of each decoder, by name, with its measures."""
    tensors = {f"{name}.{key}": value for name, own in maps.items() for key, value in own.items()}
    save_artefact(path, tensors, {"kind": KIND, "schema": SCHEMA, **header, "measures": dict(measures)})


def load_maps(path: str | os.PathLike[str]) -> tuple[Maps, dict[str, dict[str, Any]]]:
    """Read the maps and the measures of each decoder.

    Raises:
        FileNotFoundError, ValueError: as `lagsplat.io.artefact.load_artefact`.
    """
    tensors, header = load_artefact(path, kind=KIND, schema=SCHEMA)
    maps: Maps = {name: {} for name in header["measures"]}
    for key, value in tensors.items():
        name, _, what = key.partition(".")
        maps[name][what] = value
    return maps, header["measures"]
