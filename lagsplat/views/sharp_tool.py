"""Running the user's own installation of SHARP, which lifts single pictures to clouds of Gaussians.

Code and weights have licences of their own; the weights are for research only. Nothing of either is part of
this project, and nothing is fetched.
"""

import shlex
import shutil
import subprocess
import tempfile
import time
from collections.abc import Iterator, Mapping
from pathlib import Path

import cv2
import numpy as np
from PIL import Image

from lagsplat.io.ply import is_whole
from lagsplat.views.config import SharpConfig
from lagsplat.views.sharp_cache import LIFTING

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
    """The words that start the user's SHARP.

    Raises:
        ValueError: no command or checkpoint is given, or they are not there; says where to get them.
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
    """Focal length [px] of a picture by that for 35 mm film, as SHARP converts it: by the diagonals."""
    return focal_35mm * float(np.hypot(height, width)) / DIAGONAL_35MM


def lift(
    frames: Mapping[str, np.ndarray], config: SharpConfig, *, within: Path
) -> Iterator[tuple[str, Path]]:
    """Lift pictures (H, W, 3) uint8; yields the name and the PLY of each as soon as it is whole.

    The PLY is deleted once the next one is asked for. Pictures are enlarged and told their focal length, then
    handed over together, for the tool loads its network at every start. ``within`` is a folder for both.

    Raises:
        ValueError: see `require_sharp`. RuntimeError: the tool fails or leaves a picture out.
    """
    words, waiting = require_sharp(config), set(frames)
    with tempfile.TemporaryDirectory(prefix=LIFTING, dir=within) as folder:
        inputs, outputs, log = (Path(folder) / name for name in ("frames", "clouds", "log.txt"))
        inputs.mkdir()
        outputs.mkdir()
        for name, frame in frames.items():
            write_picture(inputs / f"{name}.jpg", frame, config)
        command = [*words, "predict", "-i", str(inputs), "-o", str(outputs)]
        command += ["-c", str(Path(str(config.checkpoint)).expanduser())]
        with log.open("w") as told:
            process = subprocess.Popen(command, stdout=told, stderr=subprocess.STDOUT)
        try:
            while waiting:
                ended = process.poll() is not None
                done = sorted(name for name in waiting if is_whole(outputs / f"{name}.ply"))
                for name in done:
                    yield name, outputs / f"{name}.ply"
                    (outputs / f"{name}.ply").unlink(missing_ok=True)  # unless it was moved
                    waiting.discard(name)
                if ended and waiting and not done:
                    said = log.read_text()[-LAST_WORDS:].strip()
                    raise RuntimeError(
                        f"{' '.join(words)} ended with exit code {process.returncode} and left "
                        f"{len(waiting)} of {len(frames)} frames out; its last words: {said}"
                    )
                if not done:
                    time.sleep(POLL_S)
        finally:
            process.terminate()
            process.wait()


def write_picture(path: Path, frame: np.ndarray, config: SharpConfig) -> None:
    """A frame as SHARP should see it: enlarged, since it samples corners where pixels have centres, and with
    its focal length in the header, which it reads from JPEG alone.
    """
    height, width = (config.upscale * side for side in frame.shape[:2])
    large = cv2.resize(np.asarray(frame), (width, height), interpolation=cv2.INTER_CUBIC)
    about = Image.Exif()
    about.get_ifd(EXIF_IFD)[FOCAL_35MM] = round(config.focal_35mm)
    Image.fromarray(large).save(path, exif=about, quality=QUALITY, subsampling=0)
