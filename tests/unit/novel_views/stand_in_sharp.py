"""A program with the command line of SHARP that writes PLY files of its layout: planes with the picture on.

Every picture is lifted to a depth of its own, as SHARP's are: 2 m times a factor that its mean decides.
``LIFTED`` in the environment names a file that gets a line a picture; ``SLOW`` seconds pass before each.
"""

import os
import sys
import time
from pathlib import Path

import numpy as np
from PIL import Image

NAMES = ["x", "y", "z", "f_dc_0", "f_dc_1", "f_dc_2", "opacity", "scale_0", "scale_1", "scale_2"]
NAMES += [f"rot_{i}" for i in range(4)]
SIDE, HARMONIC = 48, np.sqrt(1 / (4 * np.pi))


def words() -> dict[str, str]:
    given = sys.argv[1:]
    assert given[0] == "predict", given
    return dict(zip(given[1::2], given[2::2], strict=True))


def focal_35mm(image: Image.Image) -> float:
    return float(image.getexif().get_ifd(0x8769).get(0xA405, 30))


def lift(path: Path, out: Path) -> None:
    image = Image.open(path)
    width, height = image.size
    focal = focal_35mm(image) * np.hypot(width, height) / np.hypot(36, 24)
    color = np.asarray(image.resize((SIDE, SIDE), Image.Resampling.BOX), dtype=float).reshape(-1, 3) / 255
    row, column = np.divmod(np.arange(SIDE * SIDE), SIDE)
    u, v = (column + 0.5) * width / SIDE, (row + 0.5) * height / SIDE
    rows = []
    for layer in (0, 1):
        depth = np.full(SIDE * SIDE, (2.0 + layer) * (1 + 0.1 * np.sin(1e4 * color.mean())))
        depth *= np.where((color[:, 0] > 0.6) & (layer == 0), 0.8, 1.0)  # what is bright stands in front
        place = np.stack([(u - width / 2) * depth / focal, (v - height / 2) * depth / focal, depth], 1)
        size = np.log(
            np.stack([width / SIDE * depth / focal, height / SIDE * depth / focal, 0.01 * depth], 1)
        )
        turn = np.tile([1.0, 0.0, 0.0, 0.0], (len(depth), 1))
        rows.append(np.hstack([place, (color - 0.5) / HARMONIC, np.full((len(depth), 1), 0.5), size, turn]))
    write(out, NAMES, np.concatenate(rows), focal, width, height)


def write(out: Path, names: list[str], table: np.ndarray, focal: float, width: int, height: int) -> None:
    others = {
        "extrinsic": ("float", np.eye(4).ravel()),
        "intrinsic": ("float", np.array([focal, 0, width / 2, 0, focal, height / 2, 0, 0, 1])),
        "image_size": ("uint", np.array([width, height])),
        "frame": ("int", np.array([1, len(table)])),
        "disparity": ("float", np.quantile(1 / table[:, 2], [0.1, 0.9])),
        "color_space": ("uchar", np.array([0])),
        "version": ("uchar", np.array([1, 5, 0])),
    }
    kinds = {"float": "<f4", "uint": "<u4", "int": "<i4", "uchar": "u1"}
    head = ["ply", "format binary_little_endian 1.0", f"element vertex {len(table)}"]
    head += [f"property float {name}" for name in names]
    for name, (kind, values) in others.items():
        head += [f"element {name} {len(values)}", f"property {kind} {name}"]
    body = [
        table.astype("<f4").tobytes(),
        *(values.astype(kinds[kind]).tobytes() for kind, values in others.values()),
    ]
    with out.open("wb") as file:
        file.write(("\n".join([*head, "end_header"]) + "\n").encode())
        for part in body:
            file.write(part)
            file.flush()
            time.sleep(0.01)


def main() -> None:
    told = words()
    out = Path(told["-o"])
    assert Path(told["-c"]).is_file()
    for path in sorted(Path(told["-i"]).iterdir()):
        time.sleep(float(os.environ.get("SLOW", "0")))
        if "FAILS" in os.environ:
            sys.exit("out of memory")
        if "LIFTED" in os.environ:  # before its PLY is whole, after which the program may be ended
            with open(os.environ["LIFTED"], "a") as file:
                file.write(path.stem + "\n")
        lift(path, out / f"{path.stem}.ply")


if __name__ == "__main__":
    main()
