"""One table of all tiers: ``python -m benchmarks.gapgen.tiers --out gap_blind.csv T0=DIR T1=DIR``.

Each ``DIR`` is what the score has written.
"""

import argparse
import csv
import json
from pathlib import Path
from typing import Any

from benchmarks.gapgen.figures import lines_of

TITLES = {"T0": "trajectories", "T1": "films"}


def heading(tier: str, scores: dict[str, Any]) -> str:
    """What a tier's rows are of."""
    opened = scores.get("submissions")
    times = "" if opened is None else f", split {scores['split']}, opened {opened} time{'s' * (opened > 1)}"
    return f"{tier}, {TITLES.get(tier, tier)}: {scores['recordings']} simulated recordings{times}"


def tiers(folders: dict[str, Path], out: Path) -> None:
    """Write the rows of every tier below each other, one column a method; empty where it was not tried."""
    read = {
        tier: json.loads((folder / "scores.json").read_text(encoding="utf-8"))
        for tier, folder in folders.items()
    }
    methods = list(dict.fromkeys(["diagnosis", *(name for one in read.values() for name in one["others"])]))
    rows: list[list[str]] = []
    for tier, scores in read.items():
        every = {"diagnosis": scores, **scores["others"]}
        told = heading(tier, scores)
        for label, cells in lines_of({name: every.get(name) for name in methods}):
            rows.append([tier, told, label, *cells])
    with out.open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows([["tier", "recordings", "metric", *methods], *rows])


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True, help="file to write")
    parser.add_argument("tiers", nargs="+", metavar="TIER=DIR", help="folder of a tier's scores")
    args = parser.parse_args(argv)
    tiers({name: Path(folder) for name, folder in (pair.split("=", 1) for pair in args.tiers)}, args.out)


if __name__ == "__main__":
    main()
