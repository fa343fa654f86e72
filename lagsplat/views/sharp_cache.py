"""What SHARP made of each frame, kept by the frame's content, and never mixed with that of other cameras."""

import fcntl
import hashlib
import json
import shutil
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from jaxtyping import Float32, UInt8

from lagsplat.io.artefact import load_artefact, save_artefact
from lagsplat.io.plain import load_json, save_json

KIND, SCHEMA = "lifted", 1
MANIFEST, LOCK = "cache.json", ".lock"
LIFTING = "lifting-"
"""How folders begin in which frames are being lifted."""


@dataclass(frozen=True)
class Lifted:
    """The views of one frame: pictures, their cover in [0, 255], the depth [m] that the film's own camera
    sees, and ``told``: the ``scale`` that aligned it, what was left of the difference, and its time.
    """

    images: UInt8[np.ndarray, "V H W 3"]
    cover: UInt8[np.ndarray, "V H W"]
    depth: Float32[np.ndarray, "H W"]
    told: dict[str, Any]


@dataclass(frozen=True)
class SharpCache:
    """A folder with one file a frame and a manifest of what is common to all."""

    folder: Path

    @contextmanager
    def held(self) -> Iterator[None]:
        """Keep others out; the operating system lets go when the process ends, however it ends.

        Raises:
            BlockingIOError: another run fills this cache.
        """
        self.folder.mkdir(parents=True, exist_ok=True)
        with (self.folder / LOCK).open("w") as file:
            try:
                fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
            except BlockingIOError as error:
                raise BlockingIOError(f"another run fills the cache {self.folder}; wait for it") from error
            for left in self.folder.glob(f"{LIFTING}*"):
                # Of a killed run, whose tool may still be at work and ends for want of its frames.
                shutil.rmtree(left, ignore_errors=True)
            for half in self.folder.glob(".*.safetensors"):  # killed before it was whole
                half.unlink(missing_ok=True)
            yield

    def manifest(self) -> dict[str, Any] | None:
        """What is common to all frames, or None for a new cache."""
        path = self.folder / MANIFEST
        return load_json(path) if path.is_file() else None

    def claim(self, common: dict[str, Any]) -> None:
        """Write down what is common to all frames, or agree with what is written.

        Raises:
            ValueError: the cache was made with other cameras or settings; names them.
        """
        common = json.loads(json.dumps(common))
        there = self.manifest()
        if there is None:
            save_json(self.folder / MANIFEST, common)
            return
        other = [
            f"{key} ({there.get(key)} there, {common[key]} asked)"
            for key in common
            if there.get(key) != common[key]
        ]
        if other:
            raise ValueError(
                f"the cache {self.folder} was made with other {', '.join(other)}; give "
                "views.sharp.cache=FOLDER for another one, delete it, or go back to its settings"
            )

    def name_weights(self, digest: str) -> None:
        """Note which weights lift the frames, or agree with what is noted.

        Raises:
            ValueError: frames of other weights are there.
        """
        common = self.manifest() or {}
        if common.setdefault("weights", digest) != digest:
            raise ValueError(
                f"the cache {self.folder} holds frames lifted with other weights; give "
                "views.sharp.cache=FOLDER for another one, or delete it"
            )
        save_json(self.folder / MANIFEST, common)

    def find(self, key: str) -> Lifted | None:
        """The views of a frame, or None where there are none, or a file that is no longer whole."""
        path = self._file(key)
        if not path.is_file():
            return None
        try:
            tensors, header = load_artefact(path, kind=KIND, schema=SCHEMA)
        except ValueError:
            return None  # half-written or of other code: made again, and replaced whole
        return Lifted(tensors["images"], tensors["cover"], tensors["depth"], header["told"])

    def keep(self, key: str, lifted: Lifted) -> None:
        """Keep the views of a frame, whole or not at all."""
        tensors = {"images": lifted.images, "cover": lifted.cover, "depth": lifted.depth}
        save_artefact(self._file(key), tensors, {"kind": KIND, "schema": SCHEMA, "told": lifted.told})

    def size_mb(self) -> float:
        """Megabytes of all files."""
        return sum(path.stat().st_size for path in self.folder.rglob("*") if path.is_file()) / 1e6

    def _file(self, key: str) -> Path:
        return self.folder / f"{key}.safetensors"


def key_of(frame: np.ndarray, *settings: object) -> str:
    """A digest of a frame's pixels and shape, and of the settings by which it is lifted."""
    content = np.ascontiguousarray(frame)
    told = json.dumps([content.shape, *settings]).encode()
    return hashlib.sha256(told + content.tobytes()).hexdigest()[:32]
