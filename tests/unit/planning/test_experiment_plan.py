"""Which runs the tables and figures of an experiment are made of."""

from pathlib import Path

from lagsplat.planning.experiment_plan import ExperimentPlan, list_choices, list_image_models, list_systems
from lagsplat.planning.plan import read_overrides


def plan_of(words: str, **of_system: str) -> ExperimentPlan:
    return ExperimentPlan(read_overrides({"hydra": words, **of_system}))


def test_ablations_are_no_main_runs_and_films_have_no_truth(tmp_path: Path) -> None:
    plan = plan_of("systems=[pendulum,krauss_1seg] ablations=[constant] seeds=[0,1]")
    assert {run["stage2"] for run in plan.runs()} == {"default", "constant"}
    assert {run["stage2"] for run in plan.main_runs()} == {"default"}
    assert len(plan.main_runs()) == 4
    assert plan.true_runs() == plan.main_runs()
    film = tmp_path / "a.mp4"
    film.touch()
    filmed = plan_of(f"systems=[pendulum_pair] recording=filmed recording.path={film}")
    assert len(filmed.main_runs()) == 1
    assert filmed.true_runs() == []


def test_the_benchmark_is_of_the_arms_and_their_peers() -> None:
    plan = plan_of("systems=[pendulum,krauss_2seg] seeds=[0,1] baseline_seeds=[3,4]")
    assert list_systems(plan.krauss_runs()) == ["krauss_2seg"]
    models = list_image_models(plan.krauss_runs())
    assert [model["ae"] for model in models] == [0, 1]
    odes = plan.ode_runs()
    assert {(run["ae"], run["seed"]) for run in odes} == {(0, 0), (1, 1)}
    assert [len(runs) for runs in plan.models_of("krauss_2seg")] == [2, 2, len(odes), 8]
    assert {run["seed"] for run in plan.baseline_runs()} == {3, 4}
    first = plan.first_baselines("krauss_2seg")
    assert {run["seed"] for run in first} == {3}
    assert len(plan.name_baselines("krauss_2seg")) == len(first) == 4
    assert plan.systems_with_attention() == ["krauss_2seg"]
    assert plan.describe_models("krauss_2seg") == (
        "Krauss arm, two segments · simulated recording · profile quick"
    )


def test_image_models_of_large_batches_share_the_cores() -> None:
    threads = [
        plan.count_stage1_threads(run, cores=cores)
        for words, cores in (
            ("systems=[krauss_2seg]", 2),
            ("systems=[krauss_1seg,krauss_2seg]", 2),
            ("systems=[krauss_1seg,krauss_2seg]", 8),
            ("systems=[krauss_1seg,krauss_2seg] seeds=[0,1,2]", 2),
            ("systems=[krauss_2seg]", 64),
            ("systems=[krauss_2seg]", None),  # a cluster, whose nodes say it
            ("systems=[rainbow_rocker]", 2),  # four frames a step
        )
        for plan in [plan_of(words)]
        for run in plan.runs()[:1]
    ]
    assert threads == [2, 1, 4, 1, 8, 8, 1]


def test_forces_are_of_pictures_and_figures_have_short_names() -> None:
    plan = plan_of("systems=[rainbow_rocker,krauss_2seg,rainbow_rocker_3d]")
    assert list_systems(plan.pushable(plan.main_runs())) == ["rainbow_rocker", "krauss_2seg"]
    assert plan.pushed_mechanisms() == ["rocker", "krauss"]
    assert plan.pushed("rocker")["system"] == "rainbow_rocker"
    assert list_systems(plan.pushed_runs()) == ["rainbow_rocker", "krauss_2seg", "rainbow_rocker_3d"]


def test_arms_are_diagnosed_against_second_recordings_too() -> None:
    plan = plan_of("systems=[pendulum,krauss_1seg] seeds=[0,1]")
    pairs = [(run["system"], run["real"]) for run in plan.diagnosed()]
    assert pairs[:2] == [("pendulum", "held_out"), ("krauss_1seg", "held_out")]
    assert {real for system, real in pairs if system == "pendulum"} == {"held_out"}
    assert {real for system, real in pairs[2:]} == set(plan.experiment.planted.effects)
    assert {run["seed"] for run in plan.diagnosed()} == {0}


def test_masses_of_the_first_seeds_are_shown() -> None:
    plan = plan_of("systems=[krauss_1seg,krauss_2seg] seeds=[0,1]")
    first = plan.first_masses("krauss_2seg")
    assert {(run["system"], run["ae"], run["seed"]) for run in first} == {("krauss_2seg", 0, 0)}
    assert len({run["stage2"] for run in first}) == len(first) > 1
    assert not plan_of("systems=[pendulum]").masses_are_ablations()


def test_a_section_is_that_of_the_job() -> None:
    plan = plan_of("systems=[pendulum,krauss_1seg]", hydra_pendulum="stage1.steps=77")
    pendulum, arm = plan.main_runs()
    assert plan.section("stage1")(pendulum)["steps"] == 77
    assert plan.section("stage1")(arm)["steps"] != 77
    assert plan.titles([pendulum]) == {"pendulum": "pendulum"}
    assert list_choices({"system": "pendulum", "ae": "0", "stage2": "default"}) == {
        "system": "pendulum",
        "stage2": "default",
    }
