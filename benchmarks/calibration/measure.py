"""Measures of the alternatives on recordings whose truth is known, one line of JSON a recording.

Run as ``python -m benchmarks.calibration.measure --split DIR --out FILE``, where ``DIR`` is a public split of
`benchmarks.gapgen.make`. Every recording with an effect is measured a second time with this effect, and all
that it can pass for, left out of the catalogue: there the right answer is `unknown`. Where the tolerances of
the sim's own parameters close the gap, the alternatives are also measured without tolerances. A file that is
there is continued.
"""

import argparse
import json
import time
import warnings
from collections.abc import Mapping, Sequence
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.calibration.choices import list_true_names, pack_alternatives
from benchmarks.gapgen.answers import left_out
from lagsplat.config.compose import compose, rebuild
from lagsplat.diagnose.core.config import DiagnoseConfig
from lagsplat.diagnose.diagnosis import is_within_tolerance, search_gap
from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator
from lagsplat.diagnose.inference.effect_search import EffectSearch, combine_effects
from lagsplat.diagnose.inference.holdout import forecast_holdout
from lagsplat.diagnose.verdict.alternatives import measure_alternatives
from lagsplat.pipelines.diagnosis import prepare_search
from lagsplat.pipelines.diagnosis_inputs import open_diagnosis_inputs

KEPT = (
    "effects", "truth", "source", "system", "conditions", "d", "forced", "noise", "duration_s", "rate_hz",
    "gap", "gap_ratio", "identifiable",
)  # fmt: skip
"""What a line keeps of the answer."""


def measure_recording(place: Path, truth: Mapping[str, Any], config: DiagnoseConfig) -> dict[str, Any]:
    """Measure the alternatives of one recording with the whole catalogue, and without its true effects."""
    began = time.process_time()
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        config = replace(config, targets=truth.get("position_targets", {}))
        inputs = open_diagnosis_inputs(str(place / "sim_*.csv"), str(place / "real_*.csv"), config)
        sim, config, offset = prepare_search(inputs, config, report_progress=lambda name: None)
        search = search_gap(sim, inputs.real, config, offset)
        alternatives = measure_alternatives(search)
        row: dict[str, Any] = {"full": pack_alternatives(alternatives)}
        row["undetermined"] = bool(inputs.checked.undetermined) or not alternatives.explained
        names = list_true_names(truth["truth"])
        if not row["undetermined"] and hides_in_tolerances(search, sim):
            exact = search_gap(sim, inputs.real, config.without_tolerances(), offset)
            row["exact"] = pack_alternatives(measure_alternatives(exact))
        if names - {"unknown"} and not row["undetermined"]:
            without = leave_out_effects(search, left_out(sorted(names)))
            row["left_out"] = pack_alternatives(measure_alternatives(without))
        row["seconds"] = time.process_time() - began
    return row


def leave_out_effects(search: EffectSearch, names: Sequence[str]) -> EffectSearch:
    """The same search without the effects ``names``; the other single effects are not fitted again."""
    found = tuple(fit for fit in search.ranking.found if fit.name not in names)
    candidates = tuple(each for each in search.candidates if each.effect.name not in names)
    ranking = replace(search.ranking, found=found)
    sets, rivals = combine_effects(search.problem, ranking, candidates, search.budget)
    return replace(search, candidates=candidates, ranking=ranking, sets=sets, rivals=rivals)


def hides_in_tolerances(search: EffectSearch, sim: EstimatedSimulator) -> bool:
    """Whether the tolerances of the sim's own parameters close a gap that is open without them."""
    none = search.ranking.none
    try:
        return is_within_tolerance(forecast_holdout(search.problem, none, none, given=sim.model))
    except ValueError:  # nothing can be held out
        return False


def measure_split(folder: Path, out: Path, config: DiagnoseConfig) -> None:
    """Measure every recording of a split that ``out`` does not hold yet.

    A recording that cannot be diagnosed gets a line with its ``error``.
    """
    lines = (folder / "answers.jsonl").read_text(encoding="utf-8").splitlines()
    truths = sorted((json.loads(line) for line in lines), key=lambda truth: truth["id"])
    known = set()
    if out.exists():
        known = {json.loads(line)["id"] for line in out.read_text(encoding="utf-8").splitlines()}
    for truth in truths:
        if truth["id"] in known:
            continue
        row: dict[str, Any] = {"id": truth["id"], "answer": {name: truth.get(name) for name in KEPT}}
        try:
            row |= measure_recording(folder / "data" / truth["id"], truth, config)
        except (ValueError, ArithmeticError, np.linalg.LinAlgError) as error:
            row["error"] = str(error)
        with out.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(row) + "\n")


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--split", type=Path, required=True, help="folder of a public split")
    parser.add_argument("--out", type=Path, required=True, help="file of measures, continued if it is there")
    parser.add_argument("--settings", help="settings of the diagnosis as JSON, by default conf/diagnose")
    args = parser.parse_args(argv)
    config = rebuild(DiagnoseConfig, json.loads(args.settings)) if args.settings else compose().diagnose
    measure_split(args.split, args.out, config)


if __name__ == "__main__":
    main()
