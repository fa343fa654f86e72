"""LaGSplat on the budget of the baselines: as many frames seen, and as much wall clock.

Usage, in the folder where ``snakemake results/tables/krauss.tex`` has run::

    python -m benchmarks.equal_budget OUT [SYSTEM]...

Trains LaGSplat twice more for each system (default: both arms) under the folder OUT, each budget the median
of the system's baselines: once with the steps of stage 1 that show it as many frames (stage 2 sees none),
and once with the steps of both stages cut or stretched by one factor, such that all of it takes as long.
Scores are those of the table, on the same starts. Clocks are compared as measured: run both on a machine
that is equally busy.
"""

import subprocess
import sys
from pathlib import Path
from typing import Any

import numpy as np

from lagsplat.config.compose import compose
from lagsplat.config.schema import Config
from lagsplat.evaluate.aggregate import paired_margin
from lagsplat.io.files.atomic import load_json
from lagsplat.report.tables.benchmark import MARGIN_SCORE

ARMS = ("krauss_1seg", "krauss_2seg")
RUN = Path("default-0/default-0/metrics.json")
ROOT = Path(__file__).resolve().parents[1]


def budgets(ours: dict[str, Any], theirs: list[dict[str, Any]], config: Config) -> dict[str, tuple[str, ...]]:
    """Overrides that give LaGSplat the median budget of the baselines, by what is made equal."""
    frames, clock_s = (
        float(np.median([run["training"][name] for run in theirs])) for name in ("frames_seen", "wall_s")
    )
    factor = clock_s / ours["training"]["wall_s"]
    return {
        "frames": (f"stage1.steps={max(1, round(frames / config.stage1.batch))}",),
        "clock": (
            f"stage1.steps={max(1, round(factor * config.stage1.steps))}",
            f"stage2.effort={factor * config.stage2.effort:.4g}",
        ),
    }


def train(folder: Path, system: str, profile: str, overrides: tuple[str, ...]) -> dict[str, Any]:
    """The scores of a run with these settings, made in ``folder``."""
    folder.mkdir(parents=True, exist_ok=True)
    target = Path("results", profile, "simulated", system) / RUN
    words = [f"profile={profile}", f"systems=[{system}]", *overrides]
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "Snakefile"), "--cores", "2"]
    command += ["--directory", str(folder), str(target), "--config", f"hydra={' '.join(words)}"]
    subprocess.run(command, check=True, capture_output=True)
    return load_json(folder / target)


def line(name: str, run: dict[str, Any], ours: dict[str, Any] | None) -> str:
    """A row of the printed table; the gain is ours over this run on the same starts."""
    spent, scores = run["training"], run["scores"]
    gain = ""
    if ours is not None:
        margin = paired_margin([ours], [run], score=MARGIN_SCORE)
        gain = f"{1e3 * margin['value']:.3g} [{1e3 * margin['low']:.3g}, {1e3 * margin['high']:.3g}]"
    error = scores["frequency_error"]
    frequency = "–" if error is None else f"{100.0 * error:.2g}"
    return (
        f"| {name} | {spent['steps']} | {spent['frames_seen']} | {spent['wall_s']:.0f} "
        f"| {1e3 * scores[MARGIN_SCORE]:.3g} | {frequency} | {gain} |"
    )


def main(out: Path, systems: tuple[str, ...], *, profile: str = "quick") -> None:
    for system in systems:
        config = compose(f"profile={profile}", f"system={system}")
        place = Path("results", profile, "simulated", system)
        ours = load_json(place / RUN)
        baselines = {
            name: load_json(place / "baselines" / f"{name}-0" / "metrics.json") for name in config.baselines
        }
        print(f"\n{system}, profile {profile}; half-second error and gain in 1e-3, frequency error in %\n")
        print("| model | steps | frames seen | wall clock (s) | half second | frequency | our gain |")
        print("|---|---|---|---|---|---|---|")
        print(line("LaGSplat, own budget", ours, None))
        for equal, overrides in budgets(ours, list(baselines.values()), config).items():
            run = train(out / equal, system, profile, overrides)
            print(line(f"LaGSplat, equal {equal}", run, None))
            for name, baseline in baselines.items():
                print(line(f"{name}, against equal {equal}", baseline, run), flush=True)


if __name__ == "__main__":
    if len(sys.argv) < 2:
        sys.exit(__doc__)
    main(Path(sys.argv[1]).resolve(), tuple(sys.argv[2:]) or ARMS)
