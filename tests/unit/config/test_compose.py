"""Composition of the experiment: every file composes, and what cannot be run is named."""

from pathlib import Path

import pytest

from lagsplat.config.compose import ConfigError, _compose_anew, compose, rebuild
from lagsplat.config.schema import CONF, GROUPS, options
from lagsplat.stage1.config import Stage1Config

FILE = "recording.path=film.mp4"


@pytest.mark.parametrize("group", GROUPS)
def test_every_group_has_choices(group: str) -> None:
    assert options(group)
    assert options(group) == sorted(options(group))


@pytest.mark.parametrize("group", GROUPS)
def test_every_choice_composes(group: str) -> None:
    alone = ["system=pendulum"] if group == "release" else []  # a system is driven or let go, never both
    for name in options(group):
        cameras = ["views.rig=rig.json"] if (group, name) == ("views", "rig") else []
        experiment = compose(f"{group}={name}", FILE, *alone, *cameras)
        assert experiment.choices[group] == name


@pytest.mark.parametrize("system", options("system"))
@pytest.mark.parametrize("profile", options("profile"))
def test_every_system_composes_in_every_profile(system: str, profile: str) -> None:
    experiment = compose(f"profile={profile}", f"system={system}", FILE)
    assert experiment.choices["system"] == system
    assert experiment.stage1.d == experiment.system.d


def test_every_file_in_conf_is_a_choice_of_some_group() -> None:
    folders = {path.parent.name for path in CONF.rglob("*.yaml")} - {"conf", "archive"}
    assert folders == set(GROUPS)


def test_the_last_choice_wins() -> None:
    assert compose("profile=toy", "profile=full").choices["profile"] == "full"
    assert compose("system=toy", "system=krauss_1seg").stage1.d == 2


def test_a_profile_limits_the_budget_and_the_user_has_the_last_word() -> None:
    assert compose("profile=toy").stage1.steps < compose("profile=full").stage1.steps
    assert compose("profile=toy", "stage1.steps=77").stage1.steps == 77


@pytest.mark.parametrize(
    "values",
    [
        ("seeds=[0,3]", "systems=[toy,krauss_1seg]"),
        ("stage1.rate.encoder=5e-4", "stage1.steps=7", "blind.split=mine"),
        ("diagnose.columns={t:time}",),
        ("diagnose.columns.t=time", "diagnose.families=3"),
        ("system.d=3", "stage1.steps=8"),  # a value that others follow
        ("recording.skip_s=1", "evaluate.starts=9"),  # an integer for a number
        ("recording.dt_s=null",),
    ],
)
def test_values_set_in_what_choices_gave_are_those_that_hydra_sets(values: tuple[str, ...]) -> None:
    choices = ("profile=toy", "system=toy")
    assert compose(*choices, *values) == _compose_anew([*choices, *values])


def test_numbers_written_as_powers_of_ten_are_numbers() -> None:
    assert compose("stage1.rate.encoder=5e-4").stage1.rate.encoder == 5e-4


def test_the_published_split_and_clock() -> None:
    recording = compose("system=krauss_2seg", "recording=filmed").recording
    assert recording.split.train_fraction == 0.8
    assert recording.dt_s == pytest.approx(1001 / 60000, rel=1e-15)
    assert recording.archive is not None
    assert recording.member in recording.archive.member_sha256


@pytest.mark.parametrize(
    ("override", "words"),
    [
        ("stage1.stepz=3", ["stepz", "Stage1Config", "did you mean 'steps'"]),
        ("stage1.loss.l11=3", ["l11", "LossConfig", "did you mean 'l1'"]),
        ("recording.mcap.camra=/eye", ["camra", "McapConfig", "did you mean 'camera'"]),
        ("stage3=default", ["stage3", "did you mean"]),
        ("stage2=nope", ["stage2/nope", "constant_mass", "induced_mass"]),
        ("system=nope", ["system/nope", "krauss_2seg"]),
        ("stage1.steps=many", ["stage1.steps", "many", "conf/stage1"]),
        ("stage1.steps=null", ["stage1.steps", "conf/stage1"]),
        ("stage1.steps=0", ["stage1.steps=0", "at least 1"]),
        ("seeds=[1,1]", ["seeds=[1, 1]", "distinct"]),
        ("systems=[toi]", ["toi", "krauss_2seg", "conf/system"]),
        ("systems=[]", ["systems", "choose among"]),
        ("+more=1", ["+more=1", "key=value"]),
        ("~stage1", ["~stage1", "key=value"]),
        ("quick", ["quick", "key=value"]),
    ],
)
def test_what_cannot_be_run_is_named(override: str, words: list[str]) -> None:
    with pytest.raises(ConfigError) as caught:
        compose(override)
    for word in words:
        assert word in str(caught.value)


def test_a_film_needs_a_file_and_a_simulation_needs_a_model() -> None:
    with pytest.raises(ConfigError, match=r"pendulum_pair is filmed.*recording\.path=FILE"):
        compose("system=pendulum_pair")
    with pytest.raises(ConfigError, match=r"pendulum_pair.*recording=filmed"):
        compose("system=pendulum_pair", "recording=simulated")


def test_a_typo_in_a_file_names_the_file(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    for path in CONF.rglob("*.yaml"):
        copy = tmp_path / path.relative_to(CONF)
        copy.parent.mkdir(parents=True, exist_ok=True)
        copy.write_text(path.read_text(encoding="utf-8"), encoding="utf-8")
    broken = tmp_path / "chart" / "default.yaml"
    broken.write_text(broken.read_text(encoding="utf-8") + "smoothing: 3\n", encoding="utf-8")
    monkeypatch.setattr("lagsplat.config.schema.CONF", tmp_path)
    with pytest.raises(ConfigError, match=r"conf/chart/default\.yaml.*'smoothing'.*smoothing_frames"):
        compose("stage1.batch=3")


def test_sections_survive_plain_data() -> None:
    stage1 = compose("profile=toy").stage1
    values = {"d": stage1.d, **{name: getattr(stage1, name) for name in stage1.__dataclass_fields__}}
    assert rebuild(Stage1Config, values) == stage1
    with pytest.raises(ConfigError, match="Stage1Config"):
        rebuild(Stage1Config, {**values, "steps": -1})
