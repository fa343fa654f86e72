"""Overrides of the command line, and the runs they ask for."""

from pathlib import Path

import pytest

from lagsplat.config.compose import ConfigError
from lagsplat.planning.plan import (
    Overrides,
    compose_for,
    files_of,
    lineage,
    planned_baselines,
    planned_extrapolations,
    planned_runs,
    read_overrides,
    script_digest,
    shared_experiment,
    weights_of,
)

SCRIPTS = Path(__file__).resolve().parents[3] / "workflow" / "scripts"


def given(**command_line: str) -> Overrides:
    return read_overrides(command_line)


def test_words_are_split_as_a_shell_would() -> None:
    overrides = given(hydra="profile=toy 'recording.path=a film.mp4'", hydra_toy="stage1.steps=3")
    assert overrides.shared == ("profile=toy", "recording.path=a film.mp4")
    assert overrides.of_system == {"toy": ("stage1.steps=3",)}
    assert given().shared == ()


def test_a_setting_that_suits_films_alone_may_be_shared_among_films() -> None:
    film = "systems=[pendulum_pair] recording=filmed recording.path=film.mp4 recording.height=96"
    assert shared_experiment(given(hydra=film)).recording.height == 96
    with pytest.raises(ConfigError, match="a Krauss archive is used whole"):
        shared_experiment(given(hydra=film.replace("pendulum_pair", "krauss_2seg")))


@pytest.mark.parametrize(
    ("key", "value", "words"),
    [
        ("hydra_toi", "stage1.steps=3", "did you mean 'hydra_toy'"),
        ("hidra", "profile=toy", "did you mean 'hydra'"),
        ("hydra", "stage1.steps=3 'recording.path=a b", "drops a quote"),
        ("hydra", "system=toy", r"systems=\[\.\.\.\]"),
    ],
)
def test_unknown_keys_are_refused(key: str, value: str, words: str) -> None:
    with pytest.raises(ConfigError, match=words):
        read_overrides({key: value})


def test_a_path_wins_over_the_command_line() -> None:
    overrides = given(hydra="profile=full stage2=paper")
    assert compose_for(overrides, profile="toy").choices["profile"] == "toy"
    assert compose_for(overrides, stage2="constant").choices["stage2"] == "constant"


def test_one_system_alone_can_be_changed() -> None:
    overrides = given(hydra="stage2.steps=70", hydra_krauss_2seg="stage2.steps=71")
    assert compose_for(overrides, system="krauss_1seg").stage2.steps == 70
    assert compose_for(overrides, system="krauss_2seg").stage2.steps == 71


def test_the_toy_profile_plans_its_runs() -> None:
    runs = planned_runs(given(hydra="profile=toy seeds=[0,3]"))
    assert {(run.profile, run.recording, run.system) for run in runs} == {("toy", "simulated", "toy")}
    assert {run.stage2 for run in runs} >= {"default"}
    assert {run.seed for run in runs} == {0, 3}
    assert len(set(runs)) == len(runs)


def test_baselines_are_planned_for_arms_and_their_weights_must_be_there(tmp_path: Path) -> None:
    one = "profile=toy systems=[toy,pendulum] baselines=[osc_abcd] baseline_seeds=[0,2]"
    runs = planned_baselines(given(hydra=one))
    assert [(run.system, run.baseline, run.seed) for run in runs] == [
        ("toy", "osc_abcd", seed) for seed in (0, 2)
    ]
    folder = tmp_path / "weights"
    (folder / "toy").mkdir(parents=True)
    with pytest.raises(ConfigError, match=r"toy/osc_abcd\.pt"):
        planned_baselines(given(hydra=f"{one} baseline.weights={folder}"))
    (folder / "toy" / "osc_abcd.pt").touch()
    there = given(hydra=f"{one} baseline.weights={folder}")
    assert len(planned_baselines(there)) == 2
    assert weights_of(there, system="toy", baseline="osc_abcd") == str(folder / "toy" / "osc_abcd.pt")
    with pytest.raises(ConfigError, match="baselines="):
        planned_baselines(given(hydra="profile=toy baselines=[osc]"))


def test_the_chosen_dynamics_and_image_model_are_in_the_runs() -> None:
    runs = planned_runs(given(hydra="profile=toy stage1=upstream stage2=paper"))
    assert {run.stage1 for run in runs} == {"upstream"}
    assert runs[0].stage2 == "paper"


def test_the_full_profile_has_five_seeds_and_its_ablations() -> None:
    runs = planned_runs(given(hydra="profile=full"))
    assert {run.seed for run in runs} == {0, 1, 2, 3, 4}
    assert {run.stage2 for run in runs} >= {"networks", "constant_mass", "induced_mass"}


def test_typos_for_one_system_stop_planning() -> None:
    with pytest.raises(ConfigError, match="stepz"):
        planned_runs(given(hydra="profile=toy", hydra_krauss_1seg="stage1.stepz=3"))


def test_a_file_must_be_there_and_serve_one_system(tmp_path: Path) -> None:
    film = tmp_path / "film.npz"
    one = f"recording=filmed recording.path={film}"
    with pytest.raises(ConfigError, match=r"film\.npz.*no such file"):
        planned_runs(given(hydra=f"{one} systems=[krauss_2seg]"))
    film.touch()
    with pytest.raises(ConfigError, match=r"would serve krauss_1seg and krauss_2seg"):
        planned_runs(given(hydra=f"{one} systems=[krauss_1seg,krauss_2seg]"))
    overrides = given(hydra="systems=[krauss_1seg,krauss_2seg]", hydra_krauss_2seg=one)
    planned = [run.recording for run in planned_runs(overrides) if run.stage2 == "default"]
    assert planned == ["simulated", "filmed"]
    both = given(hydra="systems=[krauss_1seg,krauss_2seg]", hydra_krauss_1seg=one, hydra_krauss_2seg=one)
    assert {run.recording for run in planned_runs(both)} == {"filmed"}
    assert files_of(overrides, recording="filmed", system="krauss_2seg") == [str(film)]


def test_a_public_archive_needs_no_file() -> None:
    overrides = given(hydra="recording=filmed systems=[krauss_2seg]")
    assert {run.recording for run in planned_runs(overrides)} == {"filmed"}
    assert files_of(overrides, recording="filmed", system="krauss_2seg") == []


def test_a_script_is_known_by_its_code_and_not_by_its_comments(tmp_path: Path) -> None:
    script = tmp_path / "job.py"
    code = "from lagsplat.stage1.config import Stage1Config\nfrom lagsplat.planning.job import Job\nx = 1\n"
    script.write_text(f'"""What it does."""\n{code}', encoding="utf-8")
    digest = script_digest(script)
    script.write_text(f'"""Said differently."""\n# and a comment\n{code}', encoding="utf-8")
    assert script_digest(script) == digest
    script.write_text(code.replace("x = 1", "x = 2"), encoding="utf-8")
    assert script_digest(script) != digest


def test_every_script_has_a_digest_of_its_own() -> None:
    digests = {script_digest(path) for path in SCRIPTS.rglob("*.py")}
    assert len(digests) == len(list(SCRIPTS.rglob("*.py")))


def test_a_lineage_holds_what_lies_upstream_and_nothing_else() -> None:
    path = {"profile": "toy", "recording": "simulated", "system": "toy", "stage1": "default"}
    plain, other = given(hydra="profile=toy"), given(hydra="stage2.batch=33")
    for stage, changes in [("stage1", False), ("stage2", False), ("evaluate", True), ("table", True)]:
        same = lineage(plain, SCRIPTS, stage, **path) == lineage(other, SCRIPTS, stage, **path)
        assert same is not changes, stage


def test_every_clip_of_a_folder_is_an_input(tmp_path: Path) -> None:
    one = f"recording=filmed recording.path={tmp_path} systems=[pendulum_pair]"
    with pytest.raises(ConfigError, match=r"recording\.path=.*holds neither a film"):
        planned_runs(given(hydra=one))
    for name in ("b10.mp4", "b9.mp4"):
        (tmp_path / name).touch()
    assert {run.recording for run in planned_runs(given(hydra=one))} == {"filmed"}
    found = files_of(given(hydra=one), recording="filmed", system="pendulum_pair")
    assert found == [str(tmp_path / "b9.mp4"), str(tmp_path / "b10.mp4")]
    gone = given(hydra=f"recording=filmed recording.path={tmp_path}/gone.mp4 systems=[pendulum_pair]")
    with pytest.raises(ConfigError, match=r"gone\.mp4: no such file"):
        planned_runs(gone)


def test_every_file_of_a_lerobot_dataset_is_an_input(tmp_path: Path) -> None:
    names = (
        "meta/info.json",
        "data/chunk-000/file-000.parquet",
        "videos/eye/chunk-000/file-000.mp4",
        "README.md",
    )
    one = f"recording=filmed recording.kind=lerobot recording.path={tmp_path} systems=[pendulum_pair]"
    with pytest.raises(ConfigError, match=r"no such file; check the path"):
        planned_runs(given(hydra=one))
    for name in names:
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).touch()
    assert {run.recording for run in planned_runs(given(hydra=one))} == {"filmed"}
    found = files_of(given(hydra=one), recording="filmed", system="pendulum_pair")
    assert found == [str(tmp_path / name) for name in sorted(names[:3])]


def test_who_chooses_systems_gets_no_table_of_others() -> None:
    def systems(words: str) -> list[str]:
        return [run.system for run in planned_extrapolations(given(hydra=words))[0]]

    assert systems("profile=toy") == ["toy_swing"]
    assert systems("systems=[rainbow_rocker,pendulum]") == ["rainbow_rocker"]
    assert systems("recording=filmed systems=[krauss_1seg,krauss_2seg]") == []
    assert systems("systems=[pendulum] extrapolated=[rocking_chair]") == ["rocking_chair"]
    with pytest.raises(ConfigError, match="krauss_1seg is driven by its inputs"):
        systems("extrapolated=[krauss_1seg]")
