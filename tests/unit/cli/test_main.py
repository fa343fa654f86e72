"""The command line: what it prints, and how it refuses."""

import subprocess
import sys
from pathlib import Path

import h5py
import numpy as np
import pytest

from lagsplat.cli.main import VERBS, CommandError, main
from lagsplat.cli.verbs import FITTED_RUN_KEYS, parse_names, sample_times
from lagsplat.io.robot_log.write import ImageTopic, NumberTopic, write_mcap


@pytest.fixture
def archive(tmp_path: Path) -> Path:
    path = tmp_path / "arm.npz"
    rng = np.random.default_rng(0)
    pressure = np.linspace(0, 0.9, 60)
    np.savez(path, images=rng.integers(0, 256, (60, 3, 8, 8), dtype=np.uint8), p1=pressure, p2=pressure[::-1])
    return path


def refused(capsys: pytest.CaptureFixture[str], *words: str) -> str:
    assert main(list(words)) == 2
    told = capsys.readouterr()
    assert told.out == ""
    return told.err


def test_inspect_says_what_an_archive_holds(archive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["inspect", str(archive)]) == 0
    told = capsys.readouterr().out
    assert "60, 8 x 8 px" in told
    assert "input p2   0 to 0.9 atm" in told
    assert "48 frames to train on, 12 held out" in told


def test_weights_are_fetched_only_when_asked_for(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    fetched: list[Path] = []
    monkeypatch.setattr("lagsplat.baselines.released.fetch_weights", fetched.append)
    told = refused(capsys, "weights", f"out={tmp_path}")
    assert "no licence" in told
    assert "add --download" in told
    assert not fetched
    assert main(["weights", f"out={tmp_path}", "--download"]) == 0
    assert fetched == [tmp_path]
    assert "no licence" in capsys.readouterr().err


def test_inspect_lists_a_log_and_describes_what_is_chosen_of_it(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    path = tmp_path / "log.mcap"
    times, frames = np.arange(60) / 30, np.zeros((60, 8, 8, 3), np.uint8)
    load = NumberTopic("/load", times, {"p": times}, {})
    write_mcap(path, pictures=[ImageTopic("/eye", times, frames)], numbers=[load], metadata={})
    assert main(["inspect", str(path)]) == 0
    told = capsys.readouterr().out
    assert "/load" in told
    assert "recording.mcap.camera=/eye" in told
    assert "to train on" not in told
    inputs = "recording.mcap.inputs=[{topic: /load, field: p, name: p, unit: atm}]"
    assert main(["inspect", str(path), "recording.mcap.camera=/eye", inputs]) == 0
    told = capsys.readouterr().out
    assert "input p    0 to 1.967 atm" in told
    assert "48 frames to train on, 12 held out" in told


DATASET = Path(__file__).parents[1] / "io" / "lerobot" / "data" / "v30"


def test_inspect_lists_a_lerobot_dataset_and_describes_a_camera_of_it(
    capsys: pytest.CaptureFixture[str],
) -> None:
    assert main(["inspect", str(DATASET)]) == 0
    told = capsys.readouterr().out
    assert "(LeRobot 3.0, so100_follower)" in told
    assert "to train on" not in told
    assert main(["inspect", str(DATASET), "recording.lerobot.camera=observation.images.front"]) == 0
    told = capsys.readouterr().out
    assert "105, 64 x 48 px" in told
    assert "input shoulder_lift.pos -2.0" in told
    assert "84 frames to train on, 21 held out" in told
    told = refused(capsys, "inspect", str(DATASET.parent / "v22"))
    assert "no such file" in told


def test_inspect_refuses_half_a_dataset_in_one_sentence(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    (tmp_path / "meta").mkdir()
    (tmp_path / "meta/episodes.jsonl").write_text("{}")
    assert "info.json: missing" in refused(capsys, "inspect", str(tmp_path))


def test_inspect_lists_an_hdf5_file(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    with h5py.File(tmp_path / "a.h5", "w") as file:
        file["log/angle"] = np.zeros(5)
    assert main(["inspect", str(tmp_path / "a.h5")]) == 0
    assert "dataset    log/angle [5] float64" in capsys.readouterr().out


HEAVY = ("torch", "numba", "pandas", "scipy", "numpy", "hydra", "omegaconf", "cv2", "matplotlib")


@pytest.mark.parametrize("words", [["--help"], ["--version"], *([verb, "--help"] for verb in VERBS)])
def test_help_loads_no_library(words: list[str]) -> None:
    program = (
        f"import sys, lagsplat.cli.main as cli; code = cli.main({words}); "
        f"assert code == 0; print([name for name in {HEAVY} if name in sys.modules])"
    )
    done = subprocess.run([sys.executable, "-c", program], capture_output=True, text=True, check=True)
    assert done.stdout.strip().endswith("[]")


@pytest.mark.parametrize("verb", VERBS)
def test_help_of_a_verb_has_usage_keys_an_example_and_exit_codes(
    verb: str, capsys: pytest.CaptureFixture[str]
) -> None:
    assert main([verb, "--help"]) == 0
    text = capsys.readouterr().out
    assert text.startswith(f"usage: lagsplat {verb} ")
    for heading in ("keys:", "example:", "exit codes:"):
        assert f"\n{heading}\n" in text
    assert all(key in text for key, _ in VERBS[verb].keys)


@pytest.mark.parametrize("shell", ["bash", "zsh", "tcsh"])
def test_completion_knows_every_verb(shell: str, capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--print-completion", shell]) == 0
    script = capsys.readouterr().out
    assert all(verb in script for verb in VERBS)
    assert "no-browser" in script  # tcsh completes it without its dashes


def test_names_are_listed_with_or_without_brackets() -> None:
    assert parse_names("[hip, knee]") == parse_names("hip,knee") == ["hip", "knee"]
    assert parse_names(None) is None


@pytest.mark.parametrize("seconds", ["-5", "0", "nan", "inf", "1e12", "ten"])
def test_a_duration_that_cannot_be_simulated_is_refused(seconds: str) -> None:
    with pytest.raises(CommandError, match=f"seconds={seconds}: give a duration"):
        sample_times(seconds, 0.02)
    assert len(sample_times("10", 0.02)) == 500


def test_the_help_of_simulate_explains_its_keys() -> None:
    explained = {key.partition("=")[0] for key, _ in VERBS["simulate"].keys}
    assert explained >= set(FITTED_RUN_KEYS)


def test_the_version_is_that_of_the_distribution(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--version"]) == 0
    assert capsys.readouterr().out.startswith("lagsplat 0.")


def test_help_is_the_whole_grammar(capsys: pytest.CaptureFixture[str]) -> None:
    assert main(["--help"]) == 0
    told = capsys.readouterr().out
    for verb in ("inspect", "fit", "simulate", "evaluate", "export"):
        assert f"lagsplat {verb} " in told


@pytest.mark.parametrize(
    ("words", "reason"),
    [
        (["inspec", "a.npz"], "did you mean 'inspect'"),
        (["inspect"], "name a file"),
        (["view", "run", "--nowhere"], "--nowhere; see lagsplat view --help"),
        (["--nowhere"], "--nowhere"),
        (["inspect", "gone.npz"], "gone.npz: no such file"),
        (["fit", "system=toy"], "out=... is missing"),
        (["fit", "out=a", "stage1.stepz=3"], "did you mean 'steps'"),
        (["evaluate", "run=a"], "out=... is missing"),
        (["view", "gone.html"], "gone.html: no such page; `lagsplat export"),
        (["view", "run.html", "viewer.port=8081"], "run.html is a page: viewer.port=8081 has no effect"),
        (["evaluate", "run=nowhere", "out=m.json"], "no recording.safetensors"),
        (
            ["simulate", "run=a", "out=q.csv", "stage2.steps=3"],
            "'stage2.steps=3': other settings have no effect here",
        ),
        (["simulate", "run=a", "out=q.csv", "input=u.csv", "seconds=3"], "exclude each other"),
        (["export", "nowhere", "--mcap"], "no recording.safetensors"),
        (["simulate", "run=nowhere", "out=q.csv"], "no recording.safetensors"),
    ],
)
def test_what_is_invalid_is_refused(
    words: list[str],
    reason: str,
    capsys: pytest.CaptureFixture[str],
    tmp_path: Path,
    monkeypatch: pytest.MonkeyPatch,
) -> None:
    monkeypatch.chdir(tmp_path)
    assert reason in refused(capsys, *words)
    assert list(tmp_path.iterdir()) == []


def test_a_truncated_archive_is_refused(archive: Path, capsys: pytest.CaptureFixture[str]) -> None:
    archive.write_bytes(archive.read_bytes()[:2000])
    assert "arm.npz" in refused(capsys, "inspect", str(archive))
