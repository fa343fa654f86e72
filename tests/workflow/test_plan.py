"""What the workflow would do: every target plans, everything lints, and nothing that cannot run begins."""

import os
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from lagsplat.config.schema import options

ROOT = Path(__file__).resolve().parents[2]
ORDER = [
    "input",
    "output",
    "log",
    "benchmark",
    "priority",
    "conda",
    "threads",
    "resources",
    "params",
    "message",
    "script",
]
RUN = "{system}/default-0/default-0"
TARGETS = (
    "results/tables/krauss.tex",
    "results/tables/krauss.csv",
    "results/tables/krauss.html",
    "results/tables/krauss_appendix.tex",
    "results/tables/mass.tex",
    "results/tables/mass.csv",
    "results/tables/recipes.tex",
    "results/tables/recipes.csv",
    "results/tables/physical.tex",
    "results/tables/physical.csv",
    "results/tables/truth.tex",
    "results/tables/truth.csv",
    "results/tables/extrapolation.tex",
    "results/tables/extrapolation.csv",
    "results/tables/guarantee.csv",
    "results/tables/deformation.tex",
    "results/tables/deformation.csv",
    "results/tables/gap.tex",
    "results/tables/gap.csv",
    "results/tables/gap_blind.tex",
    "results/tables/gap_blind.csv",
    "results/figures/rollout_{system}.pdf",
    "results/figures/horizon_{system}.pdf",
    "results/figures/gallery_{system}.pdf",
    "results/figures/attention_{system}.pdf",
    "results/figures/inertia_{system}.pdf",
    "results/figures/equilibrium.pdf",
    "results/figures/jacobian_field.pdf",
    "results/figures/contact_sheet.png",
    "results/{profile}/simulated/" + RUN + "/rollout.png",
    "results/{profile}/simulated/" + RUN + "/metrics.json",
    "results/{profile}/simulated/{system}/default-0/reconstruction.png",
    "results/{profile}/simulated/{system}/default-0/latent.png",
    "results/{profile}/simulated/{system}/recording.safetensors",
    "results/{profile}/simulated/{system}/baselines/osc_abcd-0/metrics.json",
    "results/{profile}/simulated/{system}/baselines/koopman_deconv-0/curve.png",
)


def snakemake(folder: Path, *arguments: str) -> subprocess.CompletedProcess[str]:
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "Snakefile")]
    return subprocess.run(
        [*command, "--directory", str(folder), "--cores", "2", *arguments],
        capture_output=True,
        text=True,
        env={**os.environ, "OMP_NUM_THREADS": "1"},
        check=False,
    )


def planned(folder: Path, *arguments: str) -> str:
    done = snakemake(folder, "--dry-run", *arguments)
    assert done.returncode == 0, done.stdout + done.stderr
    return done.stdout + done.stderr


CLUSTER = yaml.safe_load((ROOT / "profiles" / "slurm" / "config.yaml").read_text("utf-8"))


@pytest.mark.parametrize(
    "profile",  # other tests plan with the quick one, part by part
    [pytest.param(name, marks=[pytest.mark.campaign] * (name == "quick")) for name in options("profile")],
)
def test_every_target_plans_and_groups_for_clusters_depend_on_nothing_that_waits_for_them(
    tmp_path: Path, profile: str
) -> None:
    """Snakemake refuses a group whose job needs a job outside that needs the group."""
    system = "toy" if profile == "toy" else "krauss_2seg"
    targets = [target.format(profile=profile, system=system) for target in TARGETS]
    few = "seeds=[0] baseline_seeds=[0] forecaster_seeds=[0] blind.t0=10 blind.t1=10"
    words = {
        key: [f"{name}={value}" for name, value in CLUSTER[key].items()]
        for key in ("groups", "group-components", "default-resources", "resources", "set-resource-scopes")
    }
    told = planned(
        tmp_path,
        *("all", *targets),
        *(word for key, values in words.items() for word in (f"--{key}", *values)),
        *("--config", f"hydra=profile={profile} {few}"),
    )
    for group in CLUSTER["group-components"]:
        assert f"Group job {group} " in told
    for rule in (
        "simulate",
        "stage1",
        "chart",
        "stage2",
        "evaluate",
        "baseline",
        "baseline_evaluate",
        "baseline_curve",
        "table",
        "mass",
        "physical",
        "truth",
        "rollout",
        "figure",
        "horizon",
        "gallery",
        "attention",
        "forecaster",
        "ode",
        "ode_evaluate",
        "extrapolate",
        "extrapolate_forecaster",
        "extrapolate_ode",
        "extrapolate_trivially",
        "extrapolation",
        "equilibrium",
        "planar_decoder",
        "velocity_field",
        "deformation",
        "jacobian_field",
        "guarantee",
        "plant",
        "diagnose",
        "gap",
        "gap_make",
        "gap_predict",
        "gap_baseline",
        "gap_open",
        "gap_left_out",
        "gap_score",
        "gap_blind",
    ):
        assert f"\n{rule} " in told, rule
    assert "\nsharpen " not in told  # a finer decoder is fitted where it is asked for
    assert not list(tmp_path.glob("results/*"))


def test_the_full_profile_trains_five_image_models_a_system_with_a_law_each(tmp_path: Path) -> None:
    told = planned(tmp_path, "--config", "hydra=profile=full ablations=[]")
    counts = {line.split()[0]: line.split()[1] for line in told.splitlines() if len(line.split()) == 2}
    # seven systems with five seeds each, and the rocker in space, which is pushed with its first
    assert (counts["stage1"], counts["stage2"]) == ("36", "36")


def test_a_file_takes_the_place_of_a_simulation(tmp_path: Path) -> None:
    film = tmp_path / "a film.npz"
    film.touch()
    file = f"recording=filmed 'recording.path={film}' recording.skip_s=0"
    told = planned(tmp_path, "results/tables/krauss.tex", "--config", f"hydra={file} systems=[krauss_2seg]")
    assert "\ningest " in told
    assert "\nsimulate " not in told
    told = planned(tmp_path, "results/tables/krauss.tex", "--config", f"hydra_krauss_2seg={file}")
    assert "\ningest " in told
    assert "\nsimulate " in told


@pytest.fixture
def film(tmp_path: Path) -> str:
    path = tmp_path / "film.mp4"
    path.touch()
    return f"hydra_pendulum_pair=recording.path={path}"


def test_the_film_of_a_pendulum_plans(tmp_path: Path, film: str) -> None:
    told = planned(tmp_path, "--config", "hydra=systems=[pendulum_pair]", film)
    assert "Read and check the recording of pendulum_pair" in told
    assert "\nphysical " in told
    assert "\ntable " not in told
    assert "\ntruth " not in told


def test_each_table_trains_what_stands_in_it(tmp_path: Path, film: str) -> None:
    """Of arms alone for the benchmark; without ablations for the other two; simulated alone for the truth."""
    config = ("--config", "hydra=systems=[toy,pendulum_pair] ablations=[constant]", film)
    runs = {
        name: set(re.findall(r"Evaluate (\w+) dynamics of (\w+)", planned(tmp_path, target, *config)))
        for name in ("krauss", "physical", "truth")
        for target in [f"results/tables/{name}.tex"]
    }
    assert runs["krauss"] == {("default", "toy"), ("constant", "toy")}
    assert runs["physical"] == {("default", "toy"), ("default", "pendulum_pair")}
    assert runs["truth"] == {("default", "toy")}


def test_a_finer_decoder_is_fitted_where_it_is_asked_for(tmp_path: Path) -> None:
    told = planned(tmp_path, "results/figures/rollout_toy.pdf", "--config", "hydra=profile=toy render=sharp")
    assert "\nrefine " in told
    assert "\nsharpen " in told


def counts(told: str) -> dict[str, int]:
    rows = [line.split() for line in told.splitlines()]
    return {row[0]: int(row[1]) for row in rows if len(row) == 2 and row[1].isdigit()}


def test_the_blind_check_predicts_every_batch_once_and_films_are_encoded_first(tmp_path: Path) -> None:
    size = "blind.t0=12 blind.t1=7 blind.batch=5 blind.left_out=6 blind.baselines=[chance,discrepancy_test]"
    told = planned(tmp_path, "results/tables/gap_blind.tex", "--config", f"hydra=profile=toy {size}")
    found = counts(told)
    assert {name: found[name] for name in found if name.startswith("gap")} == {
        "gap_make": 2,
        "gap_encode": 2,
        "gap_predict": 5,
        "gap_baseline": 10,
        "gap_open": 2,
        "gap_left_out": 4,
        "gap_score": 2,
        "gap_blind": 1,
    }


def test_the_calibration_measures_every_batch_once(tmp_path: Path) -> None:
    size = "calibration.recordings=11 calibration.batch=4"
    told = planned(tmp_path, "results/calibration/model.json", "--config", f"hydra=profile=toy {size}")
    found = counts(told)
    assert {name: found[name] for name in found if name.startswith("calibration")} == {
        "calibration_make": 3,
        "calibration_measure": 3,
        "calibration": 1,
    }


def test_a_prediction_is_told_neither_the_key_nor_the_answers() -> None:
    text = (ROOT / "workflow/rules/gap_blind.smk").read_text(encoding="utf-8")
    rules = dict(part.split(":", 1) for part in text.split("\nrule ")[1:])
    for name in ("gap_predict", "gap_baseline", "gap_encode"):
        told = rules[name].split("output:")[0] + rules[name].split("params:")[1]
        assert "key" not in told
        assert "answers" not in told
    assert "key=key_file" in rules["gap_score"]


def test_published_weights_take_the_place_of_a_training(tmp_path: Path) -> None:
    place = tmp_path / "weights" / "krauss_2seg"
    place.mkdir(parents=True)
    (place / "osc_abcd.pt").touch()
    config = f"hydra=systems=[krauss_2seg] baselines=[osc_abcd] baseline.weights={tmp_path / 'weights'}"
    target = "results/quick/simulated/krauss_2seg/baselines/osc_abcd-0/model.safetensors"
    made = tmp_path / target
    made.parent.mkdir(parents=True)
    recording = made.parents[2] / "recording"
    others = [recording.with_name("truth.safetensors"), made.with_suffix(".json"), made]
    for age_s, file in enumerate(
        (recording.with_suffix(".json"), recording.with_suffix(".safetensors"), *others)
    ):
        file.touch()
        os.utime(file, (1e9 + age_s, 1e9 + age_s))
    (reason,) = (
        line for line in planned(tmp_path, target, "--config", config).splitlines() if "Updated input" in line
    )
    assert reason.endswith("weights/krauss_2seg/osc_abcd.pt")
    done = snakemake(tmp_path, "--dry-run", "--config", config.replace("osc_abcd", "koopman_abcd"))
    assert done.returncode != 0
    assert "koopman_abcd.pt" in done.stdout + done.stderr


def test_five_forecasters_stand_in_the_full_profile_and_the_authors_only_where_they_are_given(
    tmp_path: Path,
) -> None:
    target = "results/tables/extrapolation.tex"
    config = "hydra=profile=full extrapolated=[rainbow_rocker]"
    found = counts(planned(tmp_path, target, "--config", config))
    assert (found["forecaster"], found["extrapolate_forecaster"], found["extrapolate"]) == (5, 5, 5)
    assert "authors" not in found
    frames = tmp_path / "frames"
    frames.mkdir()
    told = planned(tmp_path, target, "--config", config, f"hydra_rainbow_rocker=authors.frames={frames}")
    assert (counts(told)["authors"], counts(told)["extrapolate_authors"]) == (1, 1)


def test_a_figure_in_space_of_a_system_left_out_says_so(tmp_path: Path) -> None:
    target = "results/figures/force_rocker_3d.pdf"
    done = snakemake(tmp_path, "--dry-run", target, "--config", "hydra=systems=[rainbow_rocker]")
    assert done.returncode != 0
    assert "add its system to systems=[...]" in done.stdout + done.stderr


def test_a_system_in_space_is_compared_with_the_truth_for_every_seed(tmp_path: Path) -> None:
    config = ("--config", "hydra=systems=[rainbow_rocker,rainbow_rocker_3d] seeds=[0,1]")
    told = planned(tmp_path, "results/tables/force_truth.tex", *config)
    assert "rainbow_rocker/default-1/default-1/forces.json" in told
    assert "rainbow_rocker_3d/default-0/default-0/forces.json" in told
    assert "rainbow_rocker_3d/default-1/default-1/forces.json" in told


def test_invariants_in_space_are_those_of_its_figure(tmp_path: Path) -> None:
    config = ("--config", "hydra=systems=[rainbow_rocker,rainbow_rocker_3d]")
    told = planned(tmp_path, "results/tables/force_invariants.tex", *config)
    assert "rainbow_rocker_3d/default-0/default-0/dynamics.json" in told
    assert "rainbow_rocker/default-0/default-0/forces.json" in told
    assert "rainbow_rocker_3d/default-0/default-0/forces.json" not in told


def test_a_driven_system_is_not_extrapolated(tmp_path: Path) -> None:
    done = snakemake(tmp_path, "--dry-run", "--config", "hydra=extrapolated=[krauss_2seg]")
    assert done.returncode != 0
    assert "krauss_2seg is driven by its inputs" in done.stdout + done.stderr


@pytest.mark.parametrize(("table", "kind"), [("krauss", "a pneumatic arm"), ("truth", "simulated")])
def test_a_table_of_nothing_is_refused(tmp_path: Path, film: str, table: str, kind: str) -> None:
    target = f"results/tables/{table}.tex"
    done = snakemake(tmp_path, "--dry-run", target, "--config", "hydra=systems=[pendulum_pair]", film)
    assert done.returncode != 0
    assert f"no system of systems=['pendulum_pair'] is {kind}" in done.stdout + done.stderr


@pytest.mark.parametrize(
    ("config", "words"),
    [
        ("hydra=stage2.stepz=3", ["stepz", "did you mean 'steps'"]),
        ("hydra=stage2=nope", ["stage2/nope", "constant_mass"]),
        ("hydra=system=toy", ["systems=["]),
        ("hydra=blind.t0=0 blind.t1=0", ["blind.t0", "leave no recording"]),
        ("hydra_toi=stage2.steps=3", ["hydra_toi", "did you mean 'hydra_toy'"]),
        (
            "hydra=systems=[krauss_2seg] recording=filmed recording.path=gone.npz",
            ["gone.npz", "no such file"],
        ),
    ],
)
def test_what_cannot_be_run_stops_at_planning(tmp_path: Path, config: str, words: list[str]) -> None:
    done = snakemake(tmp_path, "--config", config)
    assert done.returncode != 0
    for word in words:
        assert word in done.stdout + done.stderr
    assert not (tmp_path / "results").exists()


def test_every_rule_says_what_it_does_where_it_logs_and_what_it_costs() -> None:
    for path in sorted((ROOT / "workflow" / "rules").glob("*.smk")):
        for text in f"\n{path.read_text(encoding='utf-8')}".split("\nrule ")[1:]:
            found = re.findall(r"^    (\w+):", text, flags=re.MULTILINE)
            assert found == [key for key in ORDER if key in found], text[:40]
            assert set(ORDER) - set(found) <= {"input", "priority"}, text[:40]


def resources_of_rules() -> dict[str, dict[str, str]]:
    """What every rule asks for, as written."""
    asked = {}
    for path in sorted((ROOT / "workflow" / "rules").glob("*.smk")):
        for text in f"\n{path.read_text(encoding='utf-8')}".split("\nrule ")[1:]:
            part = text.partition("    resources:\n")[2].partition("    params:\n")[0]
            asked[text.partition(":")[0]] = dict(
                re.findall(r"^        (\w+)=(.+),$", part, flags=re.MULTILINE)
            )
    return asked


def test_every_rule_says_its_memory_and_its_minutes() -> None:
    for rule, asked in resources_of_rules().items():
        assert set(asked) == {"mem_mb", "runtime"}, rule
        # a job on a cluster contains two processes of Snakemake besides
        assert not asked["mem_mb"].isdigit() or int(asked["mem_mb"]) >= 1500, rule
        assert asked["runtime"].isdigit() or asked["runtime"].startswith("minutes("), rule


def test_the_profiles_for_clusters_name_rules_and_groups_that_are_there() -> None:
    rules = set(resources_of_rules())
    gpu = yaml.safe_load((ROOT / "profiles" / "slurm" / "gpu.yaml").read_text("utf-8"))
    assert set(CLUSTER["groups"]) <= rules
    assert set(CLUSTER["group-components"]) == set(CLUSTER["groups"].values())
    assert set(gpu["set-resources"]) <= rules


def test_scripts_are_thin() -> None:
    for path in sorted((ROOT / "workflow" / "scripts").glob("*.py")):
        assert len(path.read_text(encoding="utf-8").splitlines()) <= 35, path.name
