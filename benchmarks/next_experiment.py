"""Whether the suggested experiment separates what a first recording leaves open.

Usage: ``python -m benchmarks.next_experiment --cases 20 --out FILE``. Each case is a mechanism with one
coordinate and one effect that has rivals, driven by a single sine, whose diagnosis is undecided: the true
effect has a probability below 0.9 and leads all others by less than 5 nats of log evidence. Then the true
mechanism is recorded once more, as often as the first suggestion says, and all files are diagnosed together.
The new recordings are that suggestion, or random excitations of equal length that reach the largest recorded
input (`benchmarks/gapgen/inputs.py`). The leaders are the two hypotheses that the experiment was planned for.
``FILE`` gets one line of JSON a case and is continued; the table is printed.
"""

import argparse
import json
import tempfile
import warnings
from collections.abc import Mapping, Sequence
from itertools import count
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.gapgen.drawing import Stratum
from benchmarks.gapgen.inputs import KINDS, excitation
from benchmarks.gapgen.make import drawn, write_columns
from benchmarks.gapgen.metrics import wilson
from benchmarks.gapgen.replay import TrueMechanism
from benchmarks.gapgen.sensors import Conditions, Sensor
from lagsplat.config.compose import compose
from lagsplat.diagnose.core.config import EXPERIMENT
from lagsplat.diagnose.core.result import Suggestion
from lagsplat.diagnose.diagnosis import DiagnosisRun
from lagsplat.diagnose.experiment.planning import select_leaders
from lagsplat.pipelines.diagnosis import run_diagnosis
from lagsplat.pipelines.diagnosis_follow_up import look_further
from lagsplat.pipelines.diagnosis_inputs import open_diagnosis_inputs

EFFECTS = (
    "mass_change", "input_lag", "viscous_damping", "linear_stiffness", "input_delay", "quadratic_drag",
    "coulomb_friction", "input_gain", "creep", "hysteresis",
)  # fmt: skip
SYSTEMS = ("pendulum", "rocker", "duffing_cart", "linear_cart")
SAME = {
    # dry friction with a parameter more; one input that is late, by whichever clock
    "coulomb_friction": {"stribeck_friction", "load_dependent_friction"},
    "input_delay": {"time_offset"},
}
"""Names that hold an effect as a special case or are the same in every recording."""
ARMS = ("suggested", "random")
CERTAIN = 0.9


def draw_case(effect: str, seed: int) -> tuple[TrueMechanism, float]:
    """A mechanism with an effect, and its noise, recorded for a few periods of a single sine."""
    rng = np.random.default_rng([seed, EFFECTS.index(effect)])
    ratio, noise = float(np.exp(rng.uniform(np.log(2.0), np.log(8.0)))), float(rng.choice([0.01, 0.02]))
    how = Conditions(60.0, Sensor(), (ratio,), tolerance=1.0, sine=True)
    system = str(rng.choice(SYSTEMS))
    stratum = Stratum((effect,), system, forced=True, noise=noise, duration_s=8.0, bin="low", conditions=how)
    return TrueMechanism(drawn(stratum, int(rng.integers(2**31))), noise), ratio


def diagnose(
    folder: Path, reals: Sequence[Mapping[str, Any]], sims: Mapping[str, Any], *, further: bool = False
) -> DiagnosisRun:
    """Diagnose recordings together against the nominal ones; ``further`` with what to record next."""
    for name, columns in {**sims, **{f"real_{i}.csv": c for i, c in enumerate(reals)}}.items():
        write_columns(folder / name, dict(columns))
    config = compose().diagnose
    with warnings.catch_warnings(), np.errstate(all="ignore"):
        warnings.simplefilter("ignore")
        files = "[" + ",".join(f'"{folder}/real_{i}.csv"' for i in range(len(reals))) + "]"
        inputs = open_diagnosis_inputs(str(folder / "sim_*.csv"), files, config)
        run = run_diagnosis(inputs, config, report_progress=lambda name: None)
        return look_further(inputs, run, config) if further else run


def judge(run: DiagnosisRun, effect: str, leaders: Sequence[str] = ()) -> dict[str, Any]:
    """What a diagnosis says of the true effect.

    Its probability, its lead in log evidence over all others [nat], and, where it is one of two ``leaders``,
    that over the other one; these are separated by a probability or a lead that is large enough.
    """
    right = {effect} | SAME.get(effect, set())
    chance = sum(c.probability for c in run.diagnosis.candidates if c.name in right)
    evidence = {"none": 0.0}
    for fit in run.ranking.found:
        evidence.setdefault(fit.name, fit.log_evidence)
    best = max((evidence[name] for name in right if name in evidence), default=-np.inf)
    lead = float(best - max(value for name, value in evidence.items() if name not in right))
    others = [evidence.get(name, -np.inf) for name in leaders if name not in right]
    pair_lead = float(best - others[0]) if len(others) == 1 and np.isfinite(others[0]) else None
    row = {"first": run.diagnosis.candidates[0].name, "probability": float(chance), "lead": lead}
    row["decided"] = bool(chance > CERTAIN or lead > EXPERIMENT.decisive)
    row["pair_lead"] = pair_lead
    row["separated"] = bool(chance > CERTAIN or (pair_lead or 0.0) > EXPERIMENT.decisive)
    return row


def play_arm(
    arm: str, world: TrueMechanism, suggestion: Suggestion, rng: np.random.Generator
) -> dict[str, Any]:
    """Columns of the second recording."""
    t = np.asarray(suggestion.input["t"])
    dt_s, d = float(t[1] - t[0]), len(suggestion.start)
    x0 = np.zeros(2 * d)
    if arm == "suggested":
        u = np.stack([u for name, u in suggestion.input.items() if name != "t"], axis=1)
        x0[:d] = list(suggestion.start.values())
    else:
        f1 = float(world.recording.truth["natural_hz"][0])
        u = excitation(t, f1, 1, rng, kinds=(str(rng.choice(KINDS)),))
        u = u * np.abs(world.recording.files["real_0.csv"]["u0"]).max() / np.abs(u).max()
    return world.play(dt_s, u, x0, rng)


def run_case(effect: str, seed: int) -> dict[str, Any]:
    """One case: its first diagnosis and, where that is undecided, one after each second recording."""
    world, ratio = draw_case(effect, seed)
    sims = {name: c for name, c in world.recording.files.items() if name.startswith("sim_")}
    real = world.recording.files["real_0.csv"]
    row: dict[str, Any] = {"effect": effect, "seed": seed, "ratio": ratio}
    with tempfile.TemporaryDirectory() as folder:
        run = diagnose(Path(folder), [real], sims, further=True)
        row |= {"before": judge(run, effect), "verdict": run.diagnosis.verdict}
        planned = run.diagnosis.next_experiments
        fits = select_leaders(run.diagnosis.candidates, run.ranking, run.chosen)
        row["between"] = ["+".join(e.effect.name for e in fit.effects) or "none" for fit in fits]
        if row["before"]["decided"]:
            return row
        playable = [each for each in planned.suggestions if each.kind != "known_payload"] if planned else []
        row["suggestion"] = None
        if playable:
            row |= {"suggestion": playable[0].kind, "nats": playable[0].nats, "repeats": playable[0].repeats}
        for arm in ARMS if playable else ():
            try:
                rng = np.random.default_rng([seed, ARMS.index(arm)])
                more = [play_arm(arm, world, playable[0], rng) for _ in range(playable[0].repeats)]
                found = diagnose(Path(folder), [real, *more], sims)
                row[arm] = judge(found, effect, row["between"])
            except (FloatingPointError, ValueError) as error:
                row[arm] = {"decided": False, "separated": False, "error": str(error)}
    return row


def format_table(rows: Sequence[Mapping[str, Any]]) -> str:
    """Shares of undecided cases that the new recordings decide, with Wilson's 95 % intervals."""
    tried = [row for row in rows if not row["before"]["decided"]]
    answered = [row for row in tried if row["suggestion"]]
    between = [row for row in answered if {row["effect"], *SAME.get(row["effect"], ())} & {*row["between"]}]
    lines = [
        f"{len(rows)} cases, {len(tried)} undecided at first, {len(answered)} of these with a suggestion; "
        f"the true effect was one of the two leaders in {len(between)}",
        "| new recordings | true leader separated from the other | from all others | its name first | "
        "median lead over the other (nat) |",
        "|---|---|---|---|---|",
    ]
    for arm in ARMS if between else ():

        def share(hits: Sequence[bool]) -> str:
            value, low, high = wilson(sum(hits), len(hits))
            return f"{sum(hits)}/{len(hits)}, {value:.2f} [{low:.2f}, {high:.2f}]"

        first = [
            row[arm].get("first") in {row["effect"]} | SAME.get(row["effect"], set()) for row in answered
        ]
        leads = [row[arm]["pair_lead"] for row in between if row[arm].get("pair_lead") is not None]
        cells = [share([row[arm]["separated"] for row in between])]
        cells += [share([row[arm]["decided"] for row in answered]), share(first)]
        lines.append(f"| {arm} | {' | '.join(cells)} | {np.median(leads):.1f} |")
    return "\n".join(lines)


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--cases", type=int, default=20, help="undecided cases with a suggestion")
    parser.add_argument("--out", type=Path, required=True, help="file of results, continued if it is there")
    args = parser.parse_args(argv)
    lines = args.out.read_text(encoding="utf-8").splitlines() if args.out.exists() else []
    rows = [json.loads(line) for line in lines]
    known = {(row["effect"], row["seed"]) for row in rows}
    for seed, effect in ((seed, effect) for seed in count() for effect in EFFECTS):
        if sum(bool(row.get("suggestion")) for row in rows) >= args.cases:
            break
        if (effect, seed) in known:
            continue
        rows.append(run_case(effect, seed))
        with args.out.open("a", encoding="utf-8") as stream:
            stream.write(json.dumps(rows[-1]) + "\n")
    print(format_table(rows))


if __name__ == "__main__":
    main()
