"""Tables of what was published: the README's, read from the published files, and that of the manifest.

Each row of the first names a page that has the same numbers with their spread, command and figures.
"""

import json
from pathlib import Path

import pandas as pd
import yaml

from benchmarks.published_sealed import list_rows

PUBLISHED = Path(__file__).resolve().parents[1] / "results" / "published"
BASELINES = ("Osc. + deconv", "Osc. + ABCD", "Koopman + deconv", "Koopman + ABCD")
SCHEDULE = 300 * 43_800  # frames that the published baselines saw in training
DRIVEN = ("krauss_1seg", "krauss_2seg")
PAGE = "docs/measurements"


def read_rows(name: str, **equal: object) -> pd.DataFrame:
    """The rows of a published table that have these values.

    Raises:
        ValueError: there is none.
    """
    table = pd.read_csv(PUBLISHED / f"{name}.csv")
    for column, value in equal.items():
        table = table[table[column].isin(value if isinstance(value, tuple) else (value,))]
    if table.empty:
        raise ValueError(f"{name}.csv has no row with {equal}")
    return table


def write_range(values: pd.Series, scale: float = 1.0, unit: str = "", digits: int = 2) -> str:
    """Smallest to largest, or one number."""
    low, high = (f"{scale * value:.{digits}g}" for value in (values.min(), values.max()))
    return f"{low}{unit}" if low == high else f"{low} to {high}{unit}"


def summarize_systems() -> tuple[str, str, str]:
    """Free rollouts of the simulated systems."""
    every = read_rows("quick_simulated_seven/physical", recording="simulated", method="LaGSplat")
    truth = read_rows("quick_simulated_seven/truth", recording="simulated")
    asked = truth["quantity"].str.match("frequency.* free rollout") & ~truth["system"].isin(DRIVEN)
    errors = truth[asked]["error"]
    lost = f"{every['diverged'].sum():.0f} of {every['rollouts'].sum():.0f} rollouts of {len(every)} systems"
    return (
        f"{len(errors)} free systems, simulated, {every['n_seeds'].min():.0f} seeds: frequency error of the "
        "free rollout against the truth; diverged, arms included",
        f"{write_range(errors, 100, ' %')}; {lost}",
        f"[systems]({PAGE}/systems.md)",
    )


def summarize_films() -> tuple[str, str, str]:
    """Free rollouts of filmed systems."""
    films = read_rows("quick_filmed_four/physical", recording="filmed")
    return (
        f"{len(films)} systems in three real videos, {films['n_seeds'].min():.0f} seed: frequency error of "
        "the rollout against the encoded video",
        write_range(films["frequency_error"], 100, " %"),
        f"[real videos]({PAGE}/real-videos.md)",
    )


def summarize_arm() -> tuple[str, str, str]:
    """Forecasts of the arm of two segments beside simple laws and trained models."""

    def read(*methods: str) -> str:
        rows = read_rows("quick_baselines/krauss", robot="krauss_2seg", recording="simulated", method=methods)
        return write_range(rows["mse_half_second"], 1e3)

    seen = read_rows("quick_baselines/krauss", robot="krauss_2seg", method=BASELINES)["frames_seen"]
    shares = write_range(seen, 100 / SCHEDULE, " %")
    return (
        "two-segment arm, simulated: image error (10⁻³) half a second ahead; linear least squares on the "
        f"same latents; mean image; four published models after {shares} of their published schedule",
        "; ".join([read("LaGSplat"), read("Linear least squares"), read("Mean image"), read(*BASELINES)]),
        f"[benchmark]({PAGE}/benchmark-quick.md)",
    )


def summarize_extrapolation() -> tuple[str, str, str]:
    """Free motion far past the clip, beside laws without structure."""

    def read(model: str) -> str:
        rows = read_rows("quick_extrapolation/extrapolation", model=model, recording="simulated")
        errors = rows.set_index("measure")["value"]
        return f"{100 * errors['frequency_error']:.2g} and {100 * errors['rate_error']:.2g} %"

    return (
        "rocker past its clip, simulated: error of frequency and of decay; neural ODE; linear least squares",
        "; ".join(read(model) for model in ("LaGSplat", "neural ODE", "linear least squares")),
        f"[extrapolation]({PAGE}/extrapolation.md)",
    )


def summarize_forces() -> tuple[str, str, str]:
    """Answers to forces against the truth."""
    rows = read_rows("quick_forces/force_truth", what="visited", recording="simulated").set_index("system")
    angles = [f"{rows['direction_deg'][name]:.1f}°" for name in ("rainbow_rocker", "hanging_bag", DRIVEN[1])]
    return (
        f"answer to a force, its direction against the truth, simulated, {rows['n_seeds'].min():.0f} seeds: "
        "rocker; bag; two-segment arm (aims 5°, 5°, 12°)",
        "; ".join(angles),
        f"[forces]({PAGE}/forces.md)",
    )


def summarize_diagnosis() -> tuple[str, str, str]:
    """Sealed recordings whose cause was named, pooled over the splits."""
    _, unseen, arm, films, every, _ = list_rows()
    return (
        "diagnosis of sealed recordings, simulated; one effect, right first: on mechanisms that nothing was "
        "fitted to; with four coordinates; from films; in all splits (aim 0.90). No effect: one named (0.03)."
        " Outside the catalogue, called unknown or undetermined (0.92)",
        ". ".join(["; ".join([unseen[2], arm[2], films[2], every[2]]), *every[5:7]]),
        f"[diagnosis]({PAGE}/diagnosis-sealed.md)",
    )


def show_summary() -> None:
    """Print the table: what was measured with its page, and the numbers."""
    print("\n| | measured |\n|---|---|")
    for summarize in (
        summarize_systems,
        summarize_films,
        summarize_arm,
        summarize_extrapolation,
        summarize_forces,
        summarize_diagnosis,
    ):
        what, numbers, page = summarize()
        print(f"| {page}: {what} | {numbers} |")
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
