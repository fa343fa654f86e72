"""Settings that follow from a film's size and from what was measured on it."""

from pathlib import Path

import pytest

from lagsplat.config.compose import compose
from lagsplat.io.video.proposal import fit_frame, propose_settings
from lagsplat.pipelines.steps import read_recording
from tests.films import PERIOD_S, RATE, swing, write_film


@pytest.mark.parametrize(
    ("size", "frame"),
    [((1080, 1920), (54, 96)), ((360, 224), (96, 60)), ((24, 32), (24, 32)), ((4, 2000), (1, 96))],
)
def test_frames_keep_their_proportions(size: tuple[int, int], frame: tuple[int, int]) -> None:
    assert fit_frame(*size) == frame


def test_a_film_is_cut_stabilised_and_smoothed_by_what_it_shows(tmp_path: Path) -> None:
    frames, _ = swing(hand_until_s=1.0)
    path = write_film(tmp_path / "hand.mkv", frames, codec="FFV1")
    settings = compose("recording=filmed", f"recording.path={str(path)!r}").recording
    with pytest.warns(UserWarning, match="a hand perhaps"):
        proposed = propose_settings(read_recording(path), settings)
    assert proposed.skip_s == pytest.approx(1.0, abs=0.1)
    assert (proposed.height, proposed.width, proposed.stabilise) == (72, 96, False)
    assert proposed.smoothing_frames == pytest.approx(PERIOD_S * RATE / 20, rel=0.05)
