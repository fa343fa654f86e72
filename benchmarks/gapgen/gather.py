"""Gather predictions: ``python -m benchmarks.gapgen.gather --seal SEAL.json --out DIR BATCH ...``.

Each ``BATCH`` is a folder of ``<id>/diagnosis.json`` with a ``made_by.json`` that names the seal it was made
under. Prints the git trees of those who predicted.
"""

import argparse
import hashlib
import json
import os
import shutil
from pathlib import Path


def gather(seal: Path, out: Path, batches: list[Path]) -> list[str]:
    """Lay the recordings of all batches side by side in ``out``; returns the trees that made them.

    Raises:
        ValueError: a batch was made under another seal, or two of them hold the same recording.
    """
    wanted = hashlib.sha256(seal.read_bytes()).hexdigest()
    shutil.rmtree(out, ignore_errors=True)
    out.mkdir(parents=True)
    trees = set()
    for batch in batches:
        made = json.loads((batch / "made_by.json").read_text(encoding="utf-8"))
        if made["seal"] != wanted:
            raise ValueError(f"{batch}: predicted under another seal than {seal}; predict this split anew")
        trees.add(f"{made['tree']}{'-dirty' if made['dirty'] else ''}")
        for place in sorted(path for path in batch.iterdir() if path.is_dir()):
            if (out / place.name).exists():
                raise ValueError(f"{batch}: {place.name} is in another batch, too")
            shutil.copytree(place, out / place.name, copy_function=os.link)
    return sorted(trees)


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--seal", type=Path, required=True, help="SEAL.json that the batches belong to")
    parser.add_argument("--out", type=Path, required=True, help="folder to write")
    parser.add_argument("batches", type=Path, nargs="*", help="folders of predictions")
    args = parser.parse_args(argv)
    print(",".join(gather(args.seal, args.out, args.batches)) or "nobody")


if __name__ == "__main__":
    main()
