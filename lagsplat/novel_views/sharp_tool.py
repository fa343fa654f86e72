"""Run the user's installation of SHARP, which lifts single images to clouds of Gaussians, and cache results.

The cache is keyed by frame content and never mixes cameras. SHARP's code and weights have their own
licences, the weights for research only; neither is part of this project or downloaded by it.
"""

import fcntl
import hashlib
import json
import shlex
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from jaxtyping import Float32, UInt8
from PIL import Image

from lagsplat.io.files.artifact import load_artifact, save_artifact
from lagsplat.io.files.atomic import load_json, save_json
from lagsplat.io.files.ply import is_whole
from lagsplat.processes import ends_with_this_process
from lagsplat.views.config import SharpConfig

KIND, SCHEMA = "lifted", 1
MANIFEST, LOCK = "cache.json", ".lock"
LIFTING = "lifting-"  # prefix of the temporary folders of frames being lifted


@dataclass(frozen=True)
class LiftedFrame:
    """Views of one frame."""

    images: UInt8[np.ndarray, "V H W 3"]
    cover: UInt8[np.ndarray, "V H W"]  # of the images, in [0, 255]
    depth: Float32[np.ndarray, "H W"]  # from the recording's camera [m]
    alignment: dict[str, Any]  # `scale` of the depths, `residual` difference, and time taken in `seconds`


@dataclass(frozen=True)
class SharpCache:
    """A folder with one file per frame and a manifest of the common settings."""

    folder: Path

    @contextmanager
    def lock(self) -> Iterator[None]:
        """Lock the cache; the operating system releases it when the process ends in any way.

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
                # From a killed run; its tool may still run, and stops without its frames.
                shutil.rmtree(left, ignore_errors=True)
            for half in self.folder.glob(".*.safetensors"):  # incomplete, from a killed run
                half.unlink(missing_ok=True)
            yield

    def manifest(self) -> dict[str, Any] | None:
        """Settings common to all frames, or None for a new cache."""
        path = self.folder / MANIFEST
        return load_json(path) if path.is_file() else None

    def claim(self, common: dict[str, Any]) -> None:
        """Write the settings common to all frames, or check them against the manifest.

        Raises:
            ValueError: the cache was made with other cameras or settings; names them.
        """
        common = json.loads(json.dumps(common))
        stored = self.manifest()
        if stored is None:
            save_json(self.folder / MANIFEST, common)
            return
        other = []
        for key, value in common.items():
            if stored.get(key) != value:
                other.append(f"{key} ({stored.get(key)} there, {value} asked)")
        if other:
            raise ValueError(
                f"the cache {self.folder} was made with other {', '.join(other)}; give "
                "views.sharp.cache=FOLDER for another one, delete it, or go back to its settings"
            )

    def name_weights(self, digest: str) -> None:
        """Record the digest of the weights that lift the frames, or check it.

        Raises:
            ValueError: the cache has frames from other weights.
        """
        common = self.manifest() or {}
        if common.setdefault("weights", digest) != digest:
            raise ValueError(
                f"the cache {self.folder} holds frames lifted with other weights; give "
                "views.sharp.cache=FOLDER for another one, or delete it"
            )
        save_json(self.folder / MANIFEST, common)

    def find(self, key: str) -> LiftedFrame | None:
        """The views of a frame, or None if there are none or the file is incomplete."""
        path = self._file(key)
        if not path.is_file():
            return None
        try:
            tensors, header = load_artifact(path, kind=KIND, schema=SCHEMA)
        except ValueError:
            return None  # incomplete or from other code: made again and replaced
        return LiftedFrame(tensors["images"], tensors["cover"], tensors["depth"], header["told"])

    def keep(self, key: str, lifted: LiftedFrame) -> None:
        """Save the views of a frame atomically."""
        tensors = {"images": lifted.images, "cover": lifted.cover, "depth": lifted.depth}
        save_artifact(self._file(key), tensors, {"kind": KIND, "schema": SCHEMA, "told": lifted.alignment})

    def size_mb(self) -> float:
        """Total size of all files [MB]."""
        return sum(path.stat().st_size for path in self.folder.rglob("*") if path.is_file()) / 1e6

    def _file(self, key: str) -> Path:
        return self.folder / f"{key}.safetensors"


def cache_key(frame: np.ndarray, *settings: object) -> str:
    """Digest of a frame's pixels and shape, and of the settings it is lifted with."""
    content = np.ascontiguousarray(frame)
    header = json.dumps([content.shape, *settings]).encode()
    return hashlib.sha256(header + content.tobytes()).hexdigest()[:32]


EXIF_IFD, FOCAL_35MM = 0x8769, 0xA405
DIAGONAL_35MM = float(np.hypot(36.0, 24.0))
QUALITY = 98
POLL_S = 0.1
LAST_WORDS = 600
WHERE = (
    "SHARP (github.com/apple/ml-sharp) and its weights sharp_2572gikvuh.pt (2.8 GB, from "
    "ml-site.cdn-apple.com/models/sharp) are under licences of their own, the weights for research only; "
    "install both yourself if these suit you, then give views.sharp.command='sharp' and "
    "views.sharp.checkpoint=FILE"
)


def require_sharp(config: SharpConfig) -> list[str]:
    """The command that starts the user's SHARP, as words.

    Raises:
        ValueError: command or checkpoint is not given or missing; says where to get them.
    """
    if config.command is None or config.checkpoint is None:
        raise ValueError(f"views=sharp: no installation is named. {WHERE}")
    words = shlex.split(config.command)
    if not words or shutil.which(words[0]) is None:
        raise ValueError(f"views.sharp.command={config.command!r}: no such program. {WHERE}")
    if not Path(config.checkpoint).expanduser().is_file():
        raise ValueError(f"views.sharp.checkpoint={config.checkpoint}: no such file. {WHERE}")
    return words


def focal_px(focal_35mm: float, *, height: int, width: int) -> float:
    """Focal length [px] of an image from its 35 mm equivalent, by the diagonals as SHARP converts it."""
    return focal_35mm * float(np.hypot(height, width)) / DIAGONAL_35MM


def run_sharp(
    frames: Mapping[str, np.ndarray], config: SharpConfig, *, within: Path
) -> Iterator[tuple[str, Path]]:
    """Lift images (H, W, 3) uint8; yield the key and the PLY of each as soon as it is complete.

    The PLY is deleted when the next is requested. Images are enlarged, get their focal length as EXIF, and
    go to the tool together, because it loads its network at every start. ``within`` is the folder for both.

    Raises:
        ValueError: see `require_sharp`.
        RuntimeError: the tool fails or omits an image.
    """
    words, waiting = require_sharp(config), set(frames)
    with tempfile.TemporaryDirectory(prefix=LIFTING, dir=within) as folder:
        inputs, outputs, log = (Path(folder) / name for name in ("frames", "clouds", "log.txt"))
        inputs.mkdir()
        outputs.mkdir()
        for name, frame in frames.items():
            write_image(inputs / f"{name}.jpg", frame, config)
        command = [*words, "predict", "-i", str(inputs), "-o", str(outputs)]
        command += ["-c", str(Path(str(config.checkpoint)).expanduser())]
        with log.open("w") as output:
            process = subprocess.Popen(
                command, stdout=output, stderr=subprocess.STDOUT, **ends_with_this_process()
            )
        try:
            while waiting:
                ended = process.poll() is not None
                done = sorted(name for name in waiting if is_whole(outputs / f"{name}.ply"))
                for name in done:
                    yield name, outputs / f"{name}.ply"
                    (outputs / f"{name}.ply").unlink(missing_ok=True)  # missing if the caller moved it
                waiting -= set(done)
                if ended and waiting and not done:
                    last_words = log.read_text()[-LAST_WORDS:].strip()
                    raise RuntimeError(
                        f"{' '.join(words)} ended with exit code {process.returncode} and left "
                        f"{len(waiting)} of {len(frames)} frames out; its last words: {last_words}"
                    )
                if not done:
                    time.sleep(POLL_S)
        finally:
            process.terminate()
            process.wait()


def write_image(path: Path, frame: np.ndarray, config: SharpConfig) -> None:
    """Write a frame as SHARP needs it: enlarged, with the focal length in the header.

    SHARP samples at the corners of pixels instead of their centres, and reads EXIF from JPEG alone.
    """
    height, width = (config.upscale * side for side in frame.shape[:2])
    large = cv2.resize(np.asarray(frame), (width, height), interpolation=cv2.INTER_CUBIC)
    about = Image.Exif()
    about.get_ifd(EXIF_IFD)[FOCAL_35MM] = round(config.focal_35mm)
    Image.fromarray(large).save(path, exif=about, quality=QUALITY, subsampling=0)
