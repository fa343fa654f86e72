"""`lagsplat inspect` describes a recording and a video, and its proposed configuration can be composed."""

from pathlib import Path

import numpy as np
import pytest
from omegaconf import OmegaConf

from lagsplat.cli.main import main
from lagsplat.config.compose import compose
from lagsplat.io.recording.recording import Recording
from lagsplat.io.video.proposal import fit_frame
from lagsplat.report.inspection.mechanism import describe_mechanism
from lagsplat.report.inspection.recording import describe_recording
from lagsplat.report.inspection.table import describe_table
from tests.films import swing, write_film
from tests.unit.io.mujoco.urdf_files import TWO, write_urdf

DT_S = 0.02


@pytest.fixture(autouse=True)
def elsewhere(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    """Sheets of films are written to the current folder."""
    monkeypatch.chdir(tmp_path)


def recording(n: int = 400) -> Recording:
    time_s = DT_S * np.arange(n)
    time_s[250:] += 1.0
    inputs = np.where(np.arange(n)[:, None] < 200, np.cos(np.pi / 10 * np.arange(n))[:, None], 0.5)
    return Recording(
        frames=np.random.default_rng(0).integers(0, 256, (n, 6, 8, 3), dtype=np.uint8),
        time_s=time_s,
        inputs=inputs,
        input_names=("p1",),
        input_units=("atm",),
        meta={"origin": "simulated", "source": "by hand", "sha256": None, "licence": "none"},
        n_train=3 * n // 4,
    )


def test_every_fact_is_said() -> None:
    text = describe_recording(recording(), config=compose("system=toy").evaluate)
    assert "by hand (simulated)" in text
    assert "400, 8 x 6 px, 1 clip(s)" in text
    assert "50.0000 frames/s" in text
    assert "input p1   -1 to 1 atm" in text
    assert "1.020 s after frame 249" in text
    assert "300 frames to train on, 100 held out" in text
    free = next(line for line in text.splitlines() if line.startswith("free"))
    assert "to 400 (4.0 s)" in free


def test_a_recording_that_is_not_divided_is_refused() -> None:
    with pytest.raises(ValueError, match="divide the recording first"):
        describe_recording(recording(300).part(0, 5), config=compose("system=toy").evaluate)


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
    x, _, width, height = tree.recording.crop
    assert x + width < 0.9 * 160, "the hand's corner is left out, with the time in which it is there"
    assert width < 0.7 * 160
    assert (tree.recording.height, tree.recording.width) == fit_frame(height, width)
    sheet = next(line for line in told.splitlines() if line.startswith("sheet"))
    assert Path(sheet.removeprefix("sheet").strip()).read_bytes().startswith(b"\x89PNG")
    assert 0.5 < tree.chart.smoothing_frames < 4.0
    split = tree.recording.pop("split")
    assert split.train_fraction == 0.8
    given = [f"recording.{key}={value!r}" for key, value in tree.recording.items() if value is not None]
    settings = compose("system=pendulum_pair", "recording.end_s=null", *given)
    assert settings.recording.path == str(path)
    assert settings.recording.grey is True
    assert settings.recording.stabilise is False


def test_a_film_in_which_nothing_moves(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames, _ = swing(amplitude=0.0)
    path = write_film(tmp_path / "still.mkv", frames, codec="FFV1")
    assert main(["inspect", str(path), "sheet=looked_at.png"]) == 0
    told = capsys.readouterr().out
    assert "warning    nothing moves" in told
    assert "crop: null" in told
    assert (tmp_path / "looked_at.png").exists()


def test_a_folder_of_films_is_told_clip_by_clip(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    frames, _ = swing(seconds=2.0)
    write_film(tmp_path / "a.mkv", frames, codec="FFV1")
    write_film(tmp_path / "b.mkv", frames[10:], codec="FFV1")
    assert main(["inspect", str(tmp_path)]) == 0
    told = capsys.readouterr().out
    assert "clip       a.mkv, 50 frames" in told
    assert "clip       b.mkv, 40 frames" in told
    assert "2 clip(s)" in told


def test_a_table_is_told_column_by_column(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    path = tmp_path / "log.csv"
    rows = "".join(f"{0.1 * i},{i % 3},on,{'' if i % 2 else 4}\n" for i in range(20))
    path.write_text(f"time,angle,state,load\n{rows}", encoding="utf-8")
    assert main(["inspect", str(path)]) == 0
    told = capsys.readouterr().out
    for words in (
        "log.csv, 20 rows",
        "column     angle: 0 to 2",
        "column     state: no numbers, not read",
        "column     load: 4 throughout, 10 missing",
        "read as    1 coordinate(s), 0 input(s), 1 clip(s)",
        "duration   1.9 s, 10 samples/s",
        "warning    log.csv: column(s) state, load are not used",
        "guess      t: time, q0: angle, from the names alone",
        f"real={path} 'diagnose.columns={{t: time, q0: angle}}'",
    ):
        assert words in told
    assert describe_table(path, {}) in told
    assert main(["inspect", str(path), "diagnose.columns={t: time, q0: angle, u0: state}"]) == 0
    assert "unreadable log.csv, line 2: column 'u0' holds 'on'" in capsys.readouterr().out
    path.write_text("a,b\n1,2\n", encoding="utf-8")
    assert main(["inspect", str(path)]) == 0
    told = capsys.readouterr().out
    assert "unreadable log.csv: no column t and no q0" in told
    assert "guess      none" in told


def test_a_mechanism_is_told_joint_by_joint(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    pytest.importorskip("mujoco")
    path = write_urdf(tmp_path / "arm.urdf", TWO, reductions=(1.0, 2.0))
    assert main(["inspect", str(path)]) == 0
    told = capsys.readouterr().out
    assert describe_mechanism(path) in told
    for words in (
        "joint      q1: j1, a hinge, -3 to 3 rad, damping 0.05 N m s/rad",
        "actuator   u0: m0",
        "mechanicalReduction",
        "LOG has columns t, q0, q1, u0, u1",
    ):
        assert words in told
    cart = tmp_path / "cart.xml"
    cart.write_text(
        '<mujoco><worldbody><body><joint name="x" type="slide" damping="0.3" frictionloss="0.2"/>'
        '<geom size="0.1" mass="1"/></body></worldbody></mujoco>'
    )
    assert main(["inspect", str(cart)]) == 0
    told = capsys.readouterr().out
    assert "joint      q0: x, a slide, damping 0.3 N s/m, dry friction 0.2 N" in told
    assert "actuator   none" in told
