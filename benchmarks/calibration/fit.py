"""Fit the choice model, and check it on sources and effects that it was not fitted to.

Run as ``python -m benchmarks.calibration.fit MEASURES ... --out FOLDER``. Measures of earlier code, which
fitted otherwise, are marked by ``--earlier FILE ...``: they have less weight in the fit, and the others
alone are checked. Writes three files:

- ``measures.jsonl.xz``: all that was measured, from which the same command makes the same model again;
- ``model.json``: the weights;
- ``validation.csv``: for each way to leave data out, shares with Wilson's 95 % intervals, and the calibration
  error.
"""

import argparse
import csv
from collections import Counter
from collections.abc import Callable, Hashable, Sequence
from pathlib import Path

import numpy as np
from scipy.optimize import minimize

from benchmarks.calibration.choices import (
    Choice,
    LabelledChoice,
    label_rows,
    read_rows,
    score_names,
    write_rows,
)
from benchmarks.gapgen.metrics import calibration, wilson
from lagsplat.diagnose.verdict.choice_model import ChoiceModel
from lagsplat.diagnose.verdict.features import NAMES
from lagsplat.diagnose.verdict.judgement import sum_by_cause
from lagsplat.io.files.atomic import save_json

RIDGE = 1.0  # precision of the prior of a weight on a feature of unit size; one recording weighs as much
FOLDS = 10


def fit_choice_model(choices: Sequence[Choice], names: tuple[str, ...], *, ridge: float) -> ChoiceModel:
    """Fit the weights to choices by maximum likelihood with a normal prior of precision ``ridge``.

    Where several alternatives are right, their probabilities add up. Choices without a right alternative are
    left out.
    """
    used = [choice for choice in choices if choice.right.any()]
    sizes = np.array([len(choice.right) for choice in used])
    features = np.concatenate([choice.features for choice in used])
    right = np.concatenate([choice.right for choice in used])
    weight = np.array([choice.weight for choice in used])
    first = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    owner = np.repeat(np.arange(len(used)), sizes)
    scale = np.maximum(np.sqrt(np.mean(features**2, axis=0)), 1e-9)
    scaled = features / scale

    def loss(w: np.ndarray) -> tuple[float, np.ndarray]:
        utility = scaled @ w
        top = np.maximum.reduceat(utility, first)[owner]
        e = np.exp(utility - top)
        every, good = np.add.reduceat(e, first), np.add.reduceat(e * right, first)
        good = np.maximum(good, 1e-300)
        share = e / every[owner] - e * right / good[owner]
        value = float(weight @ (np.log(every) - np.log(good))) + 0.5 * ridge * float(w @ w)
        return value, scaled.T @ (share * weight[owner]) + ridge * w

    # close to the optimum, so that rounding on another processor moves no digit that is published
    options = {"maxiter": 5000, "ftol": 1e-15, "gtol": 1e-9}
    found = minimize(loss, np.zeros(features.shape[1]), jac=True, method="L-BFGS-B", options=options)
    return ChoiceModel(names, found.x / scale)


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
    """Shares of what the present code measured, with Wilson's intervals, and the calibration error of the
    first name.

    A recording whose gap the sim's tolerances close is judged again beside an exact sim, as a diagnosis does.
    """
    causes = [sum_by_cause(each.mains, p) for each, p in zip(labelled, chances, strict=True)]
    pairs = list(zip(labelled, causes, strict=True))
    exact = {each.recording: cause for each, cause in pairs if each.kind == "exact"}
    shares: dict[str, list[float]] = {}
    sure, right = [], []
    for (each, cause), p in zip(pairs, chances, strict=True):
        if each.kind == "exact" or each.earlier:
            continue
        again = exact.get(each.recording) if each.kind != "left_out" else None
        if again and next(iter(cause)) == "none" and next(iter(again)) not in ("none", "unknown"):
            cause = again
        names = list(cause)
        true = each.true_names
        if each.kind in ("none", "outside", "left_out"):
            hit = names[0] == "none" if each.kind == "none" else names[0] in ("none", "unknown")
            unnamed = names[0] in ("none", "unknown")
            shares.setdefault(f"{each.kind}: not named", []).append(unnamed)
            if each.kind == "outside":
                shares.setdefault(f"outside, {min(each.families)}: not named", []).append(unnamed)
        else:
            hit = names[0] in true
            shares.setdefault(f"{each.kind}: right first", []).append(hit)
            shares.setdefault(f"{each.kind}: right in the first two", []).append(bool(true & set(names[:2])))
            shares.setdefault(f"{each.kind}: left unnamed", []).append(names[0] in ("none", "unknown"))
        if each.kind == "pair":
            best = max((i for i, main in enumerate(each.mains) if main == names[0]), key=lambda i: p[i])
            f1 = 0.0 if names[0] in ("none", "unknown") else score_names(each.names[best], each.truth)
            shares.setdefault("pair: F1", []).append(f1)
        if each.kind != "left_out":
            sure.append(cause[names[0]])
            right.append(hit)
    rows = [(name, *wilson(sum(hits), len(hits)), len(hits)) for name, hits in sorted(shares.items())]
    error, _ = calibration(np.array(sure), np.array(right, dtype=float))
    rows.append(("calibration error", error, float("nan"), float("nan"), len(sure)))
    return rows


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("measures", nargs="+", type=Path, help="files of benchmarks.calibration.measure")
    parser.add_argument(
        "--earlier", nargs="*", default=[], type=Path, help="files of measures of earlier code"
    )
    parser.add_argument("--out", type=Path, required=True, help="folder of the model and its validation")
    args = parser.parse_args(argv)
    args.out.mkdir(parents=True, exist_ok=True)
    stored = args.out / "measures.jsonl.xz"
    later = read_rows(args.measures)
    known = {row["id"] for row in later}
    before = [row | {"earlier": True} for row in read_rows(args.earlier) if row["id"] not in known]
    write_rows(stored, sorted([*later, *before], key=lambda row: str(row["id"])))
    labelled = label_rows(read_rows([stored]))
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
