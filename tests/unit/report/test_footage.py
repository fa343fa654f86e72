"""What `lagsplat inspect` adds for a film, and that its proposal can be composed."""

from pathlib import Path

import pytest
from omegaconf import OmegaConf

from lagsplat.cli.main import main
from lagsplat.config.compose import compose
from tests.films import swing, write_film


def test_a_film_is_told_and_its_proposal_composes(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames, _ = swing(hand_until_s=1.0)
    path = write_film(tmp_path / "My film.mkv", frames, codec="FFV1")
    assert main(["inspect", str(path), "recording.grey=true"]) == 0
    told, _, proposal = capsys.readouterr().out.partition("# @package _global_\n")
    for words in (
        "camera     moves 0.0",
        "exposure   0.",
        "period     1.3",
        "cuts       none",
        "a hand perhaps",
    ):
        assert words in told
    tree = OmegaConf.create(proposal)
    assert tree.recording.skip_s == pytest.approx(1.0, abs=0.1)
    assert (tree.recording.height, tree.recording.width) == (72, 96)  # 120 x 160
    assert 0.5 < tree.chart.smoothing_frames < 4.0
    split = tree.recording.pop("split")
    assert split.train_fraction == 0.8
    given = [f"recording.{key}={value!r}" for key, value in tree.recording.items() if value is not None]
    settings = compose("system=pendulum_pair", "recording.crop=null", "recording.end_s=null", *given)
    assert settings.recording.path == str(path)
    assert settings.recording.grey is True
    assert settings.recording.stabilise is False


def test_a_folder_of_films_is_told_clip_by_clip(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames, _ = swing(seconds=2.0)
    write_film(tmp_path / "a.mkv", frames, codec="FFV1")
    write_film(tmp_path / "b.mkv", frames[10:], codec="FFV1")
    assert main(["inspect", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    assert "clip       a.mkv, 50 frames" in told
    assert "clip       b.mkv, 40 frames" in told
    assert "2 clip(s)" in told
