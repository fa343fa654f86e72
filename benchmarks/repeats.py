"""Whether repeats of one experiment get the same name, each by itself and all together.

Usage: ``python -m benchmarks.repeats --cases 10 --repeats 3 --out FILE``. A case is a mechanism with one
coordinate and one effect; its experiment is repeated with other noise and slightly other starts
(`benchmarks/gapgen`). Each repeat is diagnosed, then all together. ``FILE`` gets one line of JSON a case and
is continued; the table is printed.
"""

import argparse
import json
import tempfile
from collections.abc import Mapping, Sequence
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.gapgen.drawing import Stratum
from benchmarks.gapgen.make import drawn
from benchmarks.gapgen.metrics import wilson
from benchmarks.gapgen.replay import TrueMechanism
from benchmarks.gapgen.sensors import Conditions, Sensor
from benchmarks.next_experiment import SAME, SYSTEMS, diagnose

EFFECTS = (
    "coulomb_friction", "input_lag", "mass_change", "creep", "input_dead_zone", "quadratic_drag",
    "hysteresis", "cubic_stiffness", "none", "input_delay",
)  # fmt: skip
OFF = 0.02
"""Deviation of a start from that of the first recording, over the rms of coordinate and rate."""


def run_case(number: int, repeats: int) -> dict[str, Any]:
    """First names of all repeats and of all together, and the files that disagree."""
    effect = EFFECTS[number % len(EFFECTS)]
    rng = np.random.default_rng([number, 1])
    how = Conditions(
        60.0, Sensor(), (float(np.exp(rng.uniform(np.log(3.0), np.log(12.0)))),), 1.0, sine=False
    )
    stratum = Stratum((effect,), str(rng.choice(SYSTEMS)), True, 0.01, 12.0, "middle", how)
    world = TrueMechanism(drawn(stratum, int(rng.integers(2**31))), stratum.noise)
    sims = {name: c for name, c in world.recording.files.items() if name.startswith("sim_")}
    files = [world.repeat(rng, off=OFF) for _ in range(repeats)]
    row: dict[str, Any] = {"effect": effect, "case": number, "system": stratum.system}
    with tempfile.TemporaryDirectory() as folder:
        alone = [diagnose(Path(folder), [each], sims).diagnosis for each in files]
        row["names"] = [each.candidates[0].name for each in alone]
        row["probabilities"] = [each.candidates[0].probability for each in alone]
        together = diagnose(Path(folder), files, sims, further=True).diagnosis
    row |= {"together": together.candidates[0].name, "probability": together.candidates[0].probability}
    row["files"] = [[each.before, each.after, each.own_lead, each.disagrees] for each in together.files]
    return row


def format_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Shares with Wilson's 95 % intervals."""
    pairs = [a == b for row in rows for a, b in combinations(row["names"], 2)]
    cases = [len(set(row["names"])) == 1 for row in rows]
    odd = [bool(each[3]) for row in rows for each in row["files"]]

    def is_right(row: Mapping[str, Any], name: str) -> bool:
        return name in {row["effect"]} | SAME.get(row["effect"], set())

    measures = {
        "two repeats, same name": pairs,
        "all repeats, same name": cases,
        "repeats with the name of all together": [n == row["together"] for row in rows for n in row["names"]],
        "right, one repeat": [is_right(row, name) for row in rows for name in row["names"]],
        "right, all together": [is_right(row, row["together"]) for row in rows],
        "files wrongly said to disagree": odd,
    }
    lines = ["| measure | n | share [95 %] |", "|---|---|---|"]
    for name, hits in measures.items():
        share, low, high = wilson(sum(hits), len(hits))
        lines.append(f"| {name} | {sum(hits)}/{len(hits)} | {share:.2f} [{low:.2f}, {high:.2f}] |")
    return "\n".join(lines)


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=10, help="mechanisms, each with its effect")
    parser.add_argument("--repeats", type=int, default=3, help="repeats of each experiment")
    parser.add_argument("--out", type=Path, required=True, help="file of results, continued if it is there")
    args = parser.parse_args(argv)
    lines = args.out.read_text(encoding="utf-8").splitlines() if args.out.exists() else []
    rows = [json.loads(line) for line in lines]
    for number in range(len(rows), args.cases):
        rows.append(run_case(number, args.repeats))
        with args.out.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(rows[-1]) + "\n")
    print(format_table(rows))


if __name__ == "__main__":
    main()
