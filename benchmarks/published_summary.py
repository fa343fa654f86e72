"""Tables of what was published: the README's, read from the published files, and that of the manifest.

Each row of the first has one measure beside the project's aim, and names the page that has the same number
with its spread, command and figures. What misses its aim is bold.
"""

import json
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import pandas as pd
import yaml

from benchmarks.published_aims import ARM, Aim, find_worst, is_met, judge_aims
from benchmarks.published_sealed import GROUPS, add_counts, read_scores, write_share
from benchmarks.published_tables import PUBLISHED, read_rows

BASELINES = ("Osc. + deconv", "Osc. + ABCD", "Koopman + deconv", "Koopman + ABCD")
SCHEDULE = 300 * 43_800  # frames that the published baselines saw in training
UNSEEN = "d = 1 and 2, mechanisms that nothing was fitted to"


class Measure(NamedTuple):
    """A row of the table: what was measured, how it came out, the aim, and whether it is met."""

    what: str
    found: str
    aim: str = ""
    met: bool = True


def write_range(values: pd.Series, scale: float = 1.0, unit: str = "", digits: int = 2) -> str:
    """Smallest to largest, or one number."""
    low, high = (f"{scale * value:.{digits}g}" for value in (values.min(), values.max()))
    return f"{low}{unit}" if low == high else f"{low} to {high}{unit}"


def summarize_systems() -> Iterator[Measure]:
    """Free rollouts and learned physics of the simulated systems."""
    judged = list(judge_aims("physics"))
    for quantity, what in (
        ("frequency, free rollout", "free rollouts of five systems: error of the frequency"),
        ("decay rate, free rollout", "the same without the double pendulum: error of the decay rate"),
    ):
        aim, errors = next((aim, errors) for aim, errors in judged if aim.quantity == quantity)
        asked = errors["system"].isin(aim.systems) & (errors["quantity"] == quantity)
        found = write_range(errors[asked]["error"], 100, " %")
        worst = find_worst(aim, errors, "worst_seed")
        seed = f"; worst seed {aim.write(worst[0])}" if worst else ""
        yield Measure(what, found + seed, aim.write(aim.largest), is_met(aim, errors))
    yield count_aims("learned physics of all seven", judged)
    every = read_rows("quick_simulated_seven/physical", recording="simulated", method="LaGSplat")
    windows = f"{every['long_windows'].sum():.0f} windows that do not overlap"
    rollouts = f"{every['diverged'].sum():.0f} of {every['rollouts'].sum():.0f} rollouts"
    yield Measure("rollouts that diverged, all seven", f"{rollouts}, over {windows}")


def count_aims(what: str, judged: list[tuple[Aim, pd.DataFrame]]) -> Measure:
    """How many aims are met by medians over seeds."""
    met = sum(is_met(aim, errors) for aim, errors in judged)
    return Measure(f"{what}: aims met", f"{met} of {len(judged)}", str(len(judged)), met == len(judged))


def summarize_films() -> Iterator[Measure]:
    """Free rollouts of filmed systems."""
    films = read_rows("quick_filmed_four/physical", recording="filmed")
    films = films[films["method"].str.startswith("LaGSplat")]
    found = write_range(films["frequency_error"], 100, " %")
    yield Measure(f"{len(films)} systems filmed: frequency of the rollout against the encoded video", found)


def summarize_arm() -> Iterator[Measure]:
    """Forecasts of the arm of two segments beside simple laws and trained models."""
    rows = read_rows("quick_baselines/krauss", robot=ARM, recording="simulated").set_index("method")
    errors = 1e3 * rows["mse_half_second"]
    others = ("Linear least squares", "Neural ODE", "Hamiltonian ODE", "Mean image")
    told = [f"{name} {errors[name]:.2g}" for name in others if name in errors]
    yield Measure(
        "two-segment arm: image error (10⁻³) over the next half second; other laws of the same latents",
        "; ".join([f"{errors['LaGSplat']:.2g}", *told]),
    )
    shares = write_range(rows.loc[list(BASELINES)]["frames_seen"], 100 / SCHEDULE, " %")
    yield Measure(
        f"the same: four published models after {shares} of the frames of their published schedule",
        write_range(errors[list(BASELINES)]),
    )


def summarize_extrapolation() -> Iterator[Measure]:
    """Free motion far past the clip, beside laws without structure."""

    def read(model: str) -> str:
        rows = read_rows("quick_extrapolation/extrapolation", model=model, recording="simulated")
        errors = rows.set_index("measure")["value"]
        return f"{100 * errors['frequency_error']:.2g} and {100 * errors['rate_error']:.2g} %"

    yield Measure("rocker past its clip: error of frequency and of decay", read("LaGSplat"))
    yield Measure("the same: a neural ODE of the same latents", read("neural ODE"))


def summarize_forces() -> Iterator[Measure]:
    """Answers to forces against the truth."""
    judged = list(judge_aims("forces"))
    for aim, errors in judged:
        if aim.quantity in ("direction of the pushed point", "amplitude after one poke"):
            found = find_worst(aim, errors)
            what = f"answer to a force, {aim.quantity}: {aim.title}, worst median"
            text = aim.write(found[0]) if found else "–"
            yield Measure(what, text, aim.write(aim.largest, 3), is_met(aim, errors))
    yield count_aims("answers to forces", judged)


def summarize_diagnosis() -> Iterator[Measure]:
    """Sealed recordings whose cause was named: by mechanism, then all splits."""
    splits = [split for group in GROUPS.values() for split in group]
    for measure, what, aim, is_least in (
        ("top1_class", "one effect, named first", 0.90, True),
        ("false_alarms", "no effect, one named", 0.03, False),
        ("abstention_outside", "effect outside the catalogue, left unnamed", 0.92, True),
    ):
        every, unseen = (
            add_counts([read_scores(split) for split in group], measure) for group in (splits, GROUPS[UNSEEN])
        )
        shares = [hits / trials for hits, trials in (every, unseen)]
        met = all((share >= aim) if is_least else (share <= aim) for share in shares)
        found = f"{write_share(*every)}; on mechanisms that nothing was fitted to {write_share(*unseen)}"
        yield Measure(f"sealed diagnosis: {what}", found, f"{aim:.2f}", met)
    films = add_counts([read_scores(split) for split in GROUPS["films"]], "top1_class")
    met = films[0] >= 0.80 * films[1]
    yield Measure("the same from films: one effect, named first", write_share(*films), "0.80", met)


PAGES = {
    "systems": summarize_systems,
    "real-videos": summarize_films,
    "benchmark-quick": summarize_arm,
    "extrapolation": summarize_extrapolation,
    "forces": summarize_forces,
    "diagnosis-sealed": summarize_diagnosis,
}


def show_summary() -> None:
    """Print the table: what was measured with its page, the numbers, and the aim."""
    print("\n| page | what | measured | aim |\n|---|---|---|:-:|")
    for page, summarize in PAGES.items():
        for each in summarize():
            found = each.found if each.met else f"**{each.found}**"
            link = f"[{page.replace('-', ' ')}](docs/measurements/{page}.md)"
            print(f"| {link} | {each.what} | {found} | {each.aim} |")
    print()


def show_manifest() -> None:
    """Print the table of the published folders: what they hold, and how they were made."""
    manifest = json.loads((PUBLISHED / "manifest.json").read_text("utf-8"))
    plan = yaml.safe_load(Path(__file__).with_name("published.yaml").read_text("utf-8"))
    print("\n| folder | what | seeds | commit | minutes |\n|---|---|---|---|---|")
    for name, made in manifest.items():
        seeds = made.get("seeds", {}).get("runs", ["–"])
        cells = (f"`{name}`", plan[name]["about"], ", ".join(map(str, seeds)), f"`{made['commit']}`")
        print(f"| {' | '.join(cells)} | {made['minutes']:.0f} |")
    machines = sorted({made["machine"] for made in manifest.values()})
    print(f"\nMachine: {'; '.join(machines)}.\n")
