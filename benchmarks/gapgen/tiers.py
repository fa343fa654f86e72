"""One table of all tiers: ``python -m benchmarks.gapgen.tiers --out results/tables/gap_blind T0=DIR T1=DIR``.

Each ``DIR`` is what the score has written. Writes ``OUT.csv`` and ``OUT.tex``.
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
    """Write the rows of every tier below each other, one column a method; a dash where it was not tried."""
    read = {
        tier: json.loads((folder / "scores.json").read_text(encoding="utf-8"))
        for tier, folder in folders.items()
    }
    methods = list(dict.fromkeys(["diagnosis", *(name for one in read.values() for name in one["others"])]))
    rows: list[list[str]] = []
    body: list[str] = []
    for tier, scores in read.items():
        every = {"diagnosis": scores, **scores["others"]}
        title = heading(tier, scores)
        body.append(rf"\multicolumn{{{len(methods) + 1}}}{{l}}{{\emph{{{title}}}}} \\")
        for label, cells in lines_of({name: every.get(name) for name in methods}):
            rows.append([tier, label.replace("\\", ""), *(cell[0] for cell in cells)])
            body.append(f"{label} & " + " & ".join(cell[1] for cell in cells) + r" \\")
        body.append(r"\midrule")
    with out.with_suffix(".csv").open("w", newline="", encoding="utf-8") as stream:
        csv.writer(stream).writerows([["tier", "metric", *methods], *rows])
    tex = [
        *(
            f"% {heading(tier, scores)}; diagnoser {scores.get('tree', 'unknown')}"
            for tier, scores in read.items()
        ),
        r"\begin{tabular}{l" + "r" * len(methods) + "}",
        r"\toprule",
        " & " + " & ".join(name.replace("_", " ") for name in methods) + r" \\",
        r"\midrule",
        *body[:-1],
        r"\bottomrule",
        r"\end{tabular}",
    ]
    out.with_suffix(".tex").write_text("\n".join(tex) + "\n", encoding="utf-8")


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--out", type=Path, required=True, help="files to write, without their endings")
    parser.add_argument("tiers", nargs="+", metavar="TIER=DIR", help="folder of a tier's scores")
    args = parser.parse_args(argv)
    tiers({name: Path(folder) for name, folder in (pair.split("=", 1) for pair in args.tiers)}, args.out)


if __name__ == "__main__":
    main()
