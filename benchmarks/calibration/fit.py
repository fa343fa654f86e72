"""Fit the choice model, and check it on sources and effects that it was not fitted to.

Run as ``python -m benchmarks.calibration.fit MEASURES ... --out FOLDER``. Writes ``model.json``, the weights,
and ``validation.csv``: for each way to leave data out, shares right and left unnamed with Wilson's 95 %
intervals, and the calibration error.
"""

import argparse
import csv
from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from pathlib import Path

import numpy as np

from benchmarks.calibration.choices import LabelledChoice, label_rows, read_rows
from benchmarks.gapgen.metrics import calibration, wilson
from lagsplat.diagnose.verdict.choice_model import ChoiceModel, fit_choice_model
from lagsplat.diagnose.verdict.features import NAMES
from lagsplat.io.files.atomic import save_json

RIDGE = 1.0  # precision of the prior of a weight on a feature of unit size; one recording weighs as much
FOLDS = 10
KINDS = ("single", "pair", "none", "outside", "left_out")


def fit_weights(labelled: Sequence[LabelledChoice]) -> ChoiceModel:
    """The choice model of labelled choices."""
    return fit_choice_model([each.choice for each in labelled], NAMES, ridge=RIDGE)


def predict_left_out(
    labelled: Sequence[LabelledChoice], group: Callable[[LabelledChoice], Hashable]
) -> list[np.ndarray]:
    """Probabilities of the alternatives of each choice, by a fit to all other groups."""
    groups = [group(each) for each in labelled]
    chances: list[np.ndarray] = [np.zeros(0)] * len(labelled)
    for name in sorted(set(groups), key=str):
        model = fit_weights([each for each, other in zip(labelled, groups, strict=True) if other != name])
        for i, other in enumerate(groups):
            if other == name:
                chances[i] = np.exp(model.log_probabilities(labelled[i].choice.features))
    return chances


def number_fold(each: LabelledChoice) -> int:
    """A tenth of all recordings, by their names."""
    return int(each.recording[:6], 16) % FOLDS


GROUPS: dict[str, Callable[[LabelledChoice], Hashable]] = {
    "recordings": number_fold,
    "source": lambda each: each.source,
    # recordings without an effect are of no family, and are left out by tenths
    "family": lambda each: min(each.families, default=str(number_fold(each))),
}
"""What is left out together: tenths of the recordings, sources of physics, families of effects."""


def summarize(
    labelled: Sequence[LabelledChoice], chances: Sequence[np.ndarray]
) -> list[tuple[str, float, float, float, int]]:
    """Shares with Wilson's intervals, and the calibration error of the first name."""
    rows = []
    hits: dict[str, list[bool]] = {kind: [] for kind in KINDS}
    unnamed: list[bool] = []
    sure, right = [], []
    for each, p in zip(labelled, chances, strict=True):
        first = int(np.argmax(p))
        hit = bool(each.choice.right[first])
        hits[each.kind].append(hit)
        if each.kind == "single":
            unnamed.append(each.names[first] == ("unknown",))
        if each.kind != "left_out":
            sure.append(float(p[each.choice.right].sum() if hit else p[first]))
            right.append(hit)
    for kind in KINDS:
        rows.append((f"right, {kind}", *wilson(sum(hits[kind]), len(hits[kind])), len(hits[kind])))
    rows.append(("single left unnamed", *wilson(sum(unnamed), len(unnamed)), len(unnamed)))
    error, _ = calibration(np.array(sure), np.array(right, dtype=float))
    rows.append(("calibration error", error, float("nan"), float("nan"), len(sure)))
    return rows


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("measures", nargs="+", type=Path, help="files of benchmarks.calibration.measure")
    parser.add_argument("--out", type=Path, required=True, help="folder of the model and its validation")
    args = parser.parse_args(argv)
    labelled = label_rows(read_rows(args.measures))
    args.out.mkdir(parents=True, exist_ok=True)
    with (args.out / "validation.csv").open("w", newline="", encoding="utf-8") as stream:
        table = csv.writer(stream)
        table.writerow(["left out", "measure", "value", "low", "high", "n"])
        for name, group in GROUPS.items():
            for measure, *numbers in summarize(labelled, predict_left_out(labelled, group)):
                table.writerow([name, measure, *(f"{x:.4g}" for x in numbers)])
    model = fit_weights(labelled)
    counts = dict(sorted(Counter(each.source for each in labelled).items()))
    weights = dict(zip(NAMES, model.weights.tolist(), strict=True))
    save_json(args.out / "model.json", {"weights": weights, "choices": counts, "ridge": RIDGE})


if __name__ == "__main__":
    main()
