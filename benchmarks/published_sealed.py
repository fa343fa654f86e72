"""The scores of all sealed splits in one table.

Counts are added, so that a split weighs as much as it has recordings.
What a page shows is written by ``[[[cog show_sealed() ]]]``; see `benchmarks.published_tables`.
"""

import json
import lzma
from collections.abc import Iterator
from typing import Any

from benchmarks.gapgen.metrics import wilson
from benchmarks.published_tables import PUBLISHED

SEALED = PUBLISHED / "gap_blind"
GROUPS = {
    "d = 1 and 2, mechanisms of the calibration": ("blind-1", "blind-2", "blind-5", "blind-6"),
    "d = 1 and 2, mechanisms that nothing was fitted to": ("blind-7",),
    "d = 4, soft arm": ("blind-3",),
    "films": ("blind-4", "blind-8"),
}
"""Splits that are alike, by what they hold."""
MEASURES = {
    "top1_class": "one effect: right first",
    "top2_class": "among the first two",
    "false_abstention": "called unknown or undetermined",
    "false_alarms": "no effect: one named",
    "abstention_outside": "outside the catalogue: called unknown or undetermined",
    "abstention_left_out": "true effect removed: the same",
}


def read_scores(split: str) -> dict[str, Any]:
    """The scores of a split, by all methods."""
    (path,) = (SEALED / split).glob("T*/scores.json.xz")
    scores: dict[str, Any] = json.loads(lzma.decompress(path.read_bytes()))
    return scores


def add_counts(scores: list[dict[str, Any]], measure: str) -> tuple[int, int]:
    """Hits and trials of a measure over several splits."""
    found = [each[measure] for each in scores if measure in each]
    hits = sum(round(each["value"] * each["n"]) for each in found if each["n"])
    return hits, sum(each["n"] for each in found)


def write_share(hits: int, trials: int) -> str:
    """A share with Wilson's 95 % interval and the number of trials; a dash without any."""
    if not trials:
        return "–"
    value, low, high = wilson(hits, trials)
    return f"{value:.2f} [{low:.2f}, {high:.2f}] of {trials}"


def list_rows() -> Iterator[list[str]]:
    """Cells of the table: each group, all of them, and the same by the lowest held-out error."""
    groups = {**GROUPS, "all": tuple(split for splits in GROUPS.values() for split in splits)}
    read = {split: read_scores(split) for split in groups["all"]}
    for title, splits in groups.items():
        scores = [read[split] for split in splits]
        number = sum(each["recordings"] for each in scores)
        yield [title, str(number), *(write_share(*add_counts(scores, name)) for name in MEASURES)]
    others = [each["others"]["lowest_error"] for each in read.values() if "lowest_error" in each["others"]]
    number = sum(each["recordings"] for each in others)
    title = "all, by the lowest held-out error of any effect"
    yield [title, str(number), *(write_share(*add_counts(others, name)) for name in MEASURES)]


def show_sealed() -> None:
    """Print the table, for the page that has it."""
    print(f"\n| | recordings | {' | '.join(MEASURES.values())} |")
    print(f"|---|{':-:|' * (1 + len(MEASURES))}")
    for cells in list_rows():
        print(f"| {' | '.join(cells)} |")
    print()
