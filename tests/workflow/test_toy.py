"""The toy profile from nothing to the report, and what a second call then does."""

import csv
import json
import os
import shutil
import sqlite3
import subprocess
import sys
from contextlib import closing
from pathlib import Path

import pytest

from lagsplat.cli.main import main
from lagsplat.evaluate.aggregate import MEAN_IMAGE

ROOT = Path(__file__).resolve().parents[2]
KEPT = Path(".snakemake/lagsplat-planning.sqlite")
ANSWERS = ROOT / KEPT
TOY = "hydra=profile=toy"
SCORED = {"evaluate", "rollout", "figure", "horizon", "gallery", "table", "physical", "truth", "margins"}
SIMPLE = (MEAN_IMAGE, "Hold", "Nearest neighbour")
REGRESSED = ("Linear least squares", "Koopman least squares", "Gaussian process")
EXTRAPOLATED = {
    *("extrapolate", "extrapolate_trivially", "extrapolate_forecaster", "extrapolate_ode"),
    *("extrapolation", "equilibrium"),
}
FORCES = {"forces", "force", "force_map", "force_space", "force_invariants", "force_truth"}
HERE = Path("results/toy/simulated/toy")
THERE = Path("results/toy/simulated/toy_swing")
SCORES = {
    "ae_floor",
    "mse_half_second",
    "mse_ahead",
    "frequency_error",
    "latent_nrmse",
    "image_ratio",
    "external_force",
}
COLUMNS = {"robot", "method", "dynamics", "d", "diverged", "recording", "profile", "n_seeds"} | SCORES

pytestmark = pytest.mark.slow


def snakemake(source: Path, folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(source / "Snakefile")]
    environment = {**os.environ, "PYTHONPATH": str(source)}
    return subprocess.run(
        [*command, "--directory", str(folder), "--cores", "2", *arguments],
        capture_output=True,
        text=True,
        env=environment,
        cwd=folder,  # `python -m` looks for modules there first, and must find those of the copy
        check=False,
    )


@pytest.fixture(scope="module")
def source(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A copy of the code, so that it can be edited, with what was planned before."""
    copy = tmp_path_factory.mktemp("source")
    for name in ("Snakefile", "benchmarks", "conf", "lagsplat", "profiles", "workflow"):
        place = ROOT / name
        if place.is_dir():
            # with Numba's compiled kernels, which know their source by its time
            shutil.copytree(place, copy / name, ignore=shutil.ignore_patterns("*.pyc", "*.tmp.*"))
        else:
            shutil.copy(place, copy / name)
    if ANSWERS.is_file():
        (copy / ".snakemake").mkdir()
        with closing(sqlite3.connect(ANSWERS)) as old, closing(sqlite3.connect(copy / KEPT)) as new:
            old.backup(new)  # other tests may be writing
    return copy


@pytest.fixture(scope="module")
def results(source: Path, tmp_path_factory: pytest.TempPathFactory) -> Path:
    """The folder in which the toy profile has run from nothing."""
    folder = tmp_path_factory.mktemp("toy")
    done = snakemake(source, folder, "--config", TOY)
    assert done.returncode == 0, (done.stdout + done.stderr)[-6000:]
    return folder


def jobs(source: Path, folder: Path, *config: str) -> set[str]:
    """Rules that a dry run would run."""
    done = snakemake(source, folder, "--dry-run", "--config", *config)
    assert done.returncode == 0, done.stdout + done.stderr
    lines = (done.stdout + done.stderr).splitlines()
    start = next((i for i, line in enumerate(lines) if line.startswith("Job stats")), len(lines))
    names = [line.split() for line in lines[start + 3 :]]
    found = set()
    for words in names:
        if len(words) != 2 or words[0] == "total":
            break
        found.add(words[0])
    return found - {"all"}


def test_every_artefact_is_there(results: Path) -> None:
    expected = [
        "recording.safetensors",
        "truth.safetensors",
        "default-0/autoencoder.safetensors",
        "default-0/curve.csv",
        "default-0/reconstruction.png",
        "default-0/reconstruction.pdf",
        "default-0/chart.safetensors",
        "default-0/latent.png",
        "default-0/default-0/dynamics.safetensors",
        "default-0/default-0/curve.csv",
        "default-0/default-0/metrics.json",
        "default-0/default-0/rollout.pdf",
        "default-0/default-0/rollout.png",
        "baselines/osc_abcd-0/model.safetensors",
        "baselines/osc_abcd-0/curve.png",
        "baselines/osc_abcd-0/curve.pdf",
        "baselines/koopman_deconv-0/metrics.json",
    ]
    missing = [name for name in expected if not (results / HERE / name).stat().st_size]
    assert missing == []
    assert not (results / HERE / "default-0/checkpoint/state.pt").exists()
    for figure in ("rollout", "horizon", "gallery", "attention"):
        assert (results / f"results/figures/{figure}_toy.pdf").stat().st_size


def test_the_table_says_what_it_is_of(results: Path) -> None:
    with (results / "results/tables/krauss.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert set(rows[0]) >= COLUMNS
    ours = [row for row in rows if row["robot"] == "toy"]
    assert {(row["recording"], row["profile"]) for row in ours} == {("simulated", "toy")}
    said = {row["method"]: (row["d"], row["external_force"]) for row in ours}
    assert said == {
        "LaGSplat": ("2", "anywhere"),
        "LaGSplat (constant)": ("2", "anywhere"),
        **dict.fromkeys((*SIMPLE, *REGRESSED, "Hamiltonian ODE"), ("2", "none")),
        "Osc. + ABCD": ("4", "at 2 centres"),
        "Koopman + deconv": ("4", "none"),
    }
    assert all(bool(row["margin_low"]) == (row["converged"] == "True") for row in ours if row["d"] == "4")
    assert all(0 < float(row["ae_floor"]) < 0.05 for row in ours if row["method"] != MEAN_IMAGE)
    tex = (results / "results/tables/krauss.tex").read_text(encoding="utf-8")
    assert "simulated" in tex
    assert "toy" in tex


def test_every_system_has_its_free_rollouts_and_its_truth(results: Path) -> None:
    tables = {}
    for name in ("physical", "truth"):
        with (results / f"results/tables/{name}.csv").open(encoding="utf-8") as file:
            tables[name] = list(csv.DictReader(file))
        assert (results / f"results/tables/{name}.tex").stat().st_size
    assert [row["method"] for row in tables["physical"]] == ["LaGSplat", *SIMPLE, *REGRESSED]
    assert {(row["system"], row["d"], row["n_seeds"]) for row in tables["physical"]} == {("toy", "2", "1")}
    found = {(row["quantity"], row["mode"]) for row in tables["truth"]}
    assert found >= {("frequency", "1"), ("decay rate", "1"), ("equilibrium", "")}


def test_every_model_is_followed_past_its_training_frames(results: Path) -> None:
    with (results / "results/tables/extrapolation.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    models = {row["model"] for row in rows}
    trained = {"LaGSplat", "key-point forecaster (re-implementation)", "Hamiltonian ODE"}
    assert {*trained, "mean state", "held state", "linear least squares"} == models
    ours = {row["measure"]: row for row in rows if row["model"] == "LaGSplat"}
    assert 10.0 < float(ours["psnr_mean"]["value"]) <= float(ours["floor"]["value"]) + 3.0
    found = json.loads((results / THERE / "default-0/default-0/extrapolation/run.json").read_text("utf-8"))
    assert found["guarantee"]["free_diverged"] == found["guarantee"]["held_diverged"] == 0
    with (results / "results/tables/guarantee.csv").open(encoding="utf-8") as file:
        asked = list(csv.DictReader(file))
    assert {row["stage2"] for row in asked} == {"default", "constant"}
    assert all(row["free_diverged"] == row["held_diverged"] == "0" for row in asked)
    with (results / "results/tables/deformation.csv").open(encoding="utf-8") as file:
        decoders = {row["decoder"]: row for row in csv.DictReader(file)}
    assert set(decoders) == {"conditioned", "deformed"}
    assert int(decoders["deformed"]["parameters"]) > int(decoders["conditioned"]["parameters"])
    for name in ("equilibrium", "jacobian_field"):
        assert (results / f"results/figures/{name}.pdf").stat().st_size
        assert (results / f"results/figures/{name}.png").stat().st_size
    tex = (results / "results/tables/extrapolation.tex").read_text(encoding="utf-8")
    assert "needs CUDA and was not run" in tex
    assert not (results / THERE / "forecasters/keypoints-0/checkpoint/state.pt").exists()


def test_a_setting_of_the_forecaster_trains_it_alone(source: Path, results: Path) -> None:
    rules = jobs(source, results, TOY + " forecaster.rate.colour=2e-2")
    assert rules == {"forecaster", "extrapolate_forecaster", "extrapolation", "equilibrium"}


def test_the_arm_is_pushed_in_the_picture_and_held_against_the_truth(results: Path) -> None:
    tables = {}
    for name in ("force_invariants", "force_truth"):
        with (results / f"results/tables/{name}.csv").open(encoding="utf-8") as file:
            tables[name] = list(csv.DictReader(file))
        assert (results / f"results/tables/{name}.tex").stat().st_size
    row, _ = tables["force_invariants"]
    assert (row["system"], row["method"], row["recording"]) == ("toy", "ours", "simulated")
    assert float(row["force_sum"]) < 1e-6
    assert float(row["small_answer_sum"]) < 1e-2
    assert float(row["chart_picture"]) < 1e-3
    first = {row["system"]: row["what"] for row in reversed(tables["force_truth"])}
    for system in ("toy", "toy_swing_3d"):
        assert first[system] in ("visited", "nothing measured"), "a toy's law may answer the wrong way"
    for figure in ("force", "force_map"):
        assert (results / f"results/figures/{figure}_toy.pdf").stat().st_size


def test_the_swing_is_learned_in_space_and_pushed_there(results: Path) -> None:
    with (results / "results/tables/force_invariants.csv").open(encoding="utf-8") as file:
        row = list(csv.DictReader(file))[-1]
    assert (row["system"], row["method"]) == ("toy_swing_3d", "ours, in space")
    assert float(row["across"]) < 1e-12
    run = results / "results/toy/simulated/toy_swing_3d/default-0"
    told = json.loads((run / "sides.json").read_text(encoding="utf-8"))
    assert told["held_out"]["cameras"] == 2
    assert told["held_out"]["rest"] > 15
    push = json.loads((results / "results/figures/force_toy_swing_3d.json").read_text(encoding="utf-8"))
    assert push["shift_across"] < 1e-12 < push["shift_down"]
    assert (results / "results/figures/force_toy_swing_3d.pdf").stat().st_size
    assert (run / "sides.png").stat().st_size
    assert main(["export", str(run / "default-0"), "--html", f"out={results / 'swing.html'}"]) == 0
    assert "cameras on several sides" in (results / "swing.html").read_text(encoding="utf-8")


def test_every_figure_stands_on_one_sheet(source: Path, results: Path) -> None:
    done = snakemake(source, results, "results/figures/contact_sheet.png", "--config", TOY)
    assert done.returncode == 0, (done.stdout + done.stderr)[-6000:]
    assert (results / "results/figures/contact_sheet.pdf").stat().st_size
    assert done.stderr.count("Finished jobid") <= 2, "the figures were there"


def test_the_gap_of_every_diagnosis_stands_in_a_table(source: Path, results: Path) -> None:
    done = snakemake(source, results, "results/tables/gap.tex", "--config", TOY)
    assert done.returncode == 0, (done.stdout + done.stderr)[-6000:]
    with (results / "results/tables/gap.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert [row["planted"] for row in rows] == ["", "mass_change"]
    assert {row["recording"] for row in rows} == {"simulated"}
    assert all(row["verdict"] in ("none", "effect", "unknown", "undetermined") for row in rows)
    # a toy's forecasts are too poor to tell a load by
    assert all(float(row["before"]) > 0.0 for row in rows)
    for against in ("held_out", "mass_change"):
        place = results / HERE / "default-0/default-0/gap" / against
        assert {path.name for path in place.iterdir()} >= {
            "diagnosis.json",
            "report.html",
            "rollouts.csv",
            "augmented.safetensors",
            "diagnose.json",
        }
        assert "data:image/webp" in (place / "report.html").read_text(encoding="utf-8")


def test_the_learned_law_is_compared_with_constant_coefficients(results: Path) -> None:
    with (results / "results/tables/margins.csv").open(encoding="utf-8") as file:
        rows = list(csv.DictReader(file))
    assert {(row["robot"], row["dynamics"], row["baseline"]) for row in rows} == {
        ("toy", "default", "constant")
    }
    known = [row for row in rows if row["low"]]  # two periods fit too few distinct windows for an interval
    assert known
    assert all(float(row["low"]) <= float(row["value"]) <= float(row["high"]) for row in known)


def test_the_scores_are_where_they_were(results: Path) -> None:
    """The bands are wide enough for another processor, and narrow enough to notice a stage that got worse."""
    golden = json.loads((ROOT / "tests" / "golden" / "toy.json").read_text(encoding="utf-8"))
    scores = json.loads((results / HERE / "default-0/default-0/metrics.json").read_text(encoding="utf-8"))[
        "scores"
    ]
    outside = {
        name: (scores[name], band)
        for name, band in golden.items()
        if scores[name] is None or not band["low"] <= scores[name] <= band["high"]
    }
    assert not outside


def test_metrics_and_records_say_what_made_them(results: Path) -> None:
    metrics = json.loads((results / HERE / "default-0/default-0/metrics.json").read_text(encoding="utf-8"))
    assert metrics["scores"]["diverged"] >= 0
    assert metrics["made_by"]["wildcards"]["system"] == "toy"
    record = json.loads((results / HERE / "default-0/autoencoder.json").read_text(encoding="utf-8"))
    assert record["settings"]["cfg"]["steps"] > 0
    assert record["stamp"]["versions"]["torch"]


def test_a_second_call_does_nothing(source: Path, results: Path) -> None:
    done = snakemake(source, results, "--config", TOY)
    assert "Nothing to be done" in done.stdout + done.stderr


def test_the_report_builds(source: Path, results: Path) -> None:
    done = snakemake(source, results, "--report", "report.html", "--config", TOY)
    assert done.returncode == 0, done.stdout + done.stderr
    assert (results / "report.html").stat().st_size > 10_000


def test_an_edited_comment_runs_nothing(source: Path, results: Path) -> None:
    for name in (
        "lagsplat/stage1/fit.py",
        "lagsplat/stage2/lagrangian.py",
        "workflow/scripts/stage1/stage1.py",
    ):
        path = source / name
        path.write_text("# reworded\n" + path.read_text(encoding="utf-8"), encoding="utf-8")
    assert jobs(source, results, TOY) == set()


def test_a_setting_of_stage_2_runs_stage_2_and_what_follows(source: Path, results: Path) -> None:
    rules = jobs(source, results, TOY + " stage2.gradient_clip=99")
    assert rules == {"stage2", "guarantee", *SCORED, *EXTRAPOLATED, *FORCES}


def test_a_setting_of_the_scores_trains_nothing(source: Path, results: Path) -> None:
    assert jobs(source, results, TOY + " evaluate.starts=9") == {
        *SCORED,
        "baseline_evaluate",
        "ode_evaluate",
        "simple_predictors",
    }


def test_a_setting_of_the_forces_pushes_again_and_nothing_else(source: Path, results: Path) -> None:
    assert jobs(source, results, TOY + " forces.brush=0.1") == FORCES


def test_a_setting_of_a_baseline_trains_it_alone(source: Path, results: Path) -> None:
    rules = jobs(source, results, TOY + " baseline.rate.peak=2e-3")
    assert rules == {
        "baseline",
        "baseline_evaluate",
        "baseline_curve",
        "horizon",
        "gallery",
        "attention",
        "table",
    }


def test_a_setting_of_one_system_leaves_the_others(source: Path, results: Path) -> None:
    assert jobs(source, results, TOY, "hydra_krauss_1seg=stage1.steps=9") == set()
    assert "stage1" in jobs(source, results, TOY, "hydra_toy=stage1.steps=9")


def test_edited_code_runs_what_depends_on_it(source: Path, results: Path) -> None:
    path = source / "lagsplat/evaluate/forecast.py"
    text = path.read_text(encoding="utf-8")
    path.write_text(text + "\nUNUSED = 1\n", encoding="utf-8")
    rules = jobs(source, results, TOY)
    path.write_text(text, encoding="utf-8")
    assert "evaluate" in rules
    assert not rules & {"simulate", "stage1", "chart", "stage2"}


def test_a_failed_run_leaves_earlier_results_whole_and_is_tried_again(source: Path, results: Path) -> None:
    path = source / "lagsplat/stage2/fit.py"
    text = path.read_text(encoding="utf-8")
    broken = text.replace("    torch.manual_seed(seed)\n", "    raise ValueError('no luck')\n", 1)
    assert broken != text
    path.write_text(broken, encoding="utf-8")
    dynamics = results / HERE / "default-0/default-0/dynamics.safetensors"
    before = dynamics.read_bytes()
    done = snakemake(source, results, "results/tables/krauss.tex", "--config", TOY)
    assert done.returncode != 0
    assert "stage2: no luck" in done.stdout + done.stderr
    assert dynamics.read_bytes() == before
    assert (results / "results/tables/krauss.tex").exists()
    assert "stage2" in jobs(source, results, TOY)
    path.write_text(text, encoding="utf-8")
