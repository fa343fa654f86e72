"""Score: ``python -m benchmarks.gapgen.score --predictions DIR --answers FILE [--key KEY] --out OUT``.

``FILE`` is ``answers.jsonl`` of a public split, or ``SEAL.json`` of a sealed one, which then is checked,
opened with the key and counted in ``submissions.log`` beside it; a sealed split yields aggregates only,
until ``--reveal``. Other methods join the table by ``--also NAME=DIR``. ``--left-out DIR`` holds the
diagnoses made without the true effect; ``--runs-to-make FILE`` writes the list of those runs.
"""

import argparse
import datetime
import json
from pathlib import Path
from typing import Any

from benchmarks.gapgen.aggregate import aggregate, by_effect, by_stratum, permuted_top1
from benchmarks.gapgen.answers import left_out as struck
from benchmarks.gapgen.figures import confusion, reliability, risk, table
from benchmarks.gapgen.keys import read_key
from benchmarks.gapgen.metrics import ABSTAINED, Item, closures, set_f1, share
from benchmarks.gapgen.predictions import read_prediction
from benchmarks.gapgen.seal import METRICS_VERSION, merkle_root, unseal


def read_answers(path: Path, key: str | None) -> list[dict[str, Any]]:
    """The answers of a public or sealed split.

    Raises:
        ValueError: if a sealed split comes without its key.
    """
    if path.name != "SEAL.json":
        text = path.read_text(encoding="utf-8")
    elif key is None:
        raise ValueError(f"{path}: sealed; give its key with --key @FILE")
    else:
        text = unseal(read_key(key), path.parent)
    return [json.loads(line) for line in text.splitlines()]


def items_of(answers: list[dict[str, Any]], folder: Path) -> list[Item]:
    """Truth and prediction of every recording; those of films are in coordinates of their own."""
    return [
        Item(truth, read_prediction(folder / truth["id"], [] if truth.get("tier") == "T1" else truth["rms"]))
        for truth in answers
    ]


def runs_to_make(answers: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """Recordings to diagnose again with the true effect, and all that it can pass for, left out."""
    return [
        {"id": truth["id"], "without": struck(truth["truth"][0]["class"])}
        for truth in answers
        if len(truth["truth"]) == 1 and truth["identifiable"] and truth["effects"] != ["unknown"]
    ]


def left_out(answers: list[dict[str, Any]], folder: Path) -> dict[str, float]:
    """Share of the runs without the true effect that abstain, among those that were made."""
    wanted = {run["id"] for run in runs_to_make(answers)}
    items = items_of([truth for truth in answers if truth["id"] in wanted], folder)
    return share([i for i in items if i.said.verdict != "missing"], lambda i: i.said.verdict in ABSTAINED)


def per_item(items: list[Item]) -> list[dict[str, Any]]:
    """One row a recording, for looking at failures."""
    rows = []
    for i in items:
        found = closures(i) if i.truth["truth"] else None
        rows.append(
            {
                "id": i.truth["id"],
                "true": [entry["kind"] for entry in i.truth["truth"]] or ["none"],
                "class": sorted(i.accepted),
                "verdict": i.said.verdict,
                "ranking": [
                    [name, round(i.said.probability.get(name, 0.0), 4)] for name in i.said.ranking[:4]
                ],
                "combination": list(i.said.combination),
                "right": i.among(1, whole_class=True) if i.kind != "pair" else set_f1(i, whole_class=True),
                "closure": found[0] if found else None,
                "oracle": found[1] if found else None,
                **{
                    name: i.truth[name]
                    for name in ("identifiable", "system", "forced", "noise", "duration_s")
                },
                "gap_ratio": i.truth["gap_ratio"],
            }
        )
    return rows


def log_submission(seal_path: Path, predictions: Path, tree: str, scores: dict[str, Any]) -> int:
    """Append this opening of a sealed split to ``submissions.log`` and return how many there have been."""
    log = seal_path.with_name("submissions.log")
    entry = {
        "time": datetime.datetime.now(datetime.UTC).isoformat(timespec="seconds"),
        "predictions": merkle_root(predictions),
        "diagnoser": tree,
        "metrics_version": METRICS_VERSION,
        "top1_class": scores["top1_class"],
    }
    with log.open("a", encoding="utf-8") as stream:
        stream.write(json.dumps(entry) + "\n")
    return len(log.read_text(encoding="utf-8").splitlines())


def score(
    answers: list[dict[str, Any]],
    predictions: Path,
    out: Path,
    *,
    also: dict[str, Path],
    without: Path | None,
) -> tuple[dict[str, Any], list[Item]]:
    """Write figures, tables and ``scores.json``'s content for the predictions and the other methods.

    Returns:
        The scores and the items of the predictions.
    """
    out.mkdir(parents=True, exist_ok=True)
    items = items_of(answers, predictions)
    scores = aggregate(items)
    if without is not None:
        scores["abstention_left_out"] = left_out(answers, without)
    others = {name: aggregate(items_of(answers, folder)) for name, folder in also.items()}
    table({"diagnosis": scores, **others}, out)
    confusion(items, out)
    reliability(scores["reliability"], scores["ece_class"], out)
    risk(items, out)
    whole = scores | {
        "permuted_top1_class": permuted_top1(items),
        "by_stratum": by_stratum(items),
        "by_effect": by_effect(items),
        "others": others,
    }
    return whole, items


def _summary(scores: dict[str, Any]) -> str:
    lines = []
    for name, found in scores.items():
        if isinstance(found, dict) and "low" in found:
            lines.append(
                f"{name:22s} {found['value']:.3f} [{found['low']:.3f}, {found['high']:.3f}] n={found['n']}"
            )
        elif isinstance(found, dict) and "median" in found:
            lines.append(f"{name:22s} median {found['median']:.3f} p10 {found['p10']:.3f} n={found['n']}")
        elif isinstance(found, float | int):
            lines.append(f"{name:22s} {found:.3f}" if isinstance(found, float) else f"{name:22s} {found}")
    return "\n".join(lines)


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--predictions", type=Path, required=True, help="folder of <id>/diagnosis.json")
    parser.add_argument("--answers", type=Path, required=True, help="answers.jsonl or SEAL.json")
    parser.add_argument("--key", help="key of a sealed split, or @FILE")
    parser.add_argument("--out", type=Path, required=True, help="folder for scores, figures and tables")
    parser.add_argument(
        "--also", action="append", default=[], metavar="NAME=DIR", help="another method's predictions"
    )
    parser.add_argument("--left-out", type=Path, help="predictions made without the true effect")
    parser.add_argument("--runs-to-make", type=Path, help="write the runs without the true effect here")
    parser.add_argument("--tree", default="unknown", help="git tree of the diagnoser, for the log")
    parser.add_argument(
        "--reveal", action="store_true", help="write per-item results of a sealed split: it is spent"
    )
    args = parser.parse_args(argv)
    answers = read_answers(args.answers, args.key)
    sealed = args.answers.name == "SEAL.json"
    also = {name: Path(folder) for name, folder in (pair.split("=", 1) for pair in args.also)}
    if args.runs_to_make:
        args.runs_to_make.write_text(
            "".join(json.dumps(run) + "\n" for run in runs_to_make(answers)), encoding="utf-8"
        )
    scores, items = score(answers, args.predictions, args.out, also=also, without=args.left_out)
    if sealed:
        scores["submissions"] = log_submission(args.answers, args.predictions, args.tree, scores)
        scores["split"] = json.loads(args.answers.read_text(encoding="utf-8"))["split"]
    scores["tree"] = args.tree
    if not sealed or args.reveal:
        rows = "".join(json.dumps(row) + "\n" for row in per_item(items))
        (args.out / "per_item.jsonl").write_text(rows, encoding="utf-8")
    (args.out / "scores.json").write_text(json.dumps(scores, indent=1) + "\n", encoding="utf-8")
    print(_summary(scores))


if __name__ == "__main__":
    main()
