"""A camera that moved during a film or since another, and what of a film is left out."""

from dataclasses import replace

import cv2
import numpy as np
import pytest

from lagsplat.diagnose.imaging.video_checks import check_camera, drop_unusable_frames, measure_camera_shift
from lagsplat.io.recording.recording import Recording
from tests.unit.evaluate import tiny_run

SIDE = 64
RNG = np.random.default_rng(3)


def wall():
    """A textured background, larger than the picture by ten pixels on each side."""
    coarse = RNG.uniform(40, 220, (14, 14, 3)).astype(np.float32)
    return cv2.resize(coarse, (SIDE + 20, SIDE + 20), interpolation=cv2.INTER_NEAREST)


WALL = wall()


def film(path_px, *, frames=60):
    """A dark disk that swings before the wall, seen by a camera that goes along ``path_px`` (frames, 2)."""
    rows, columns = np.indices((SIDE, SIDE)) + 0.5
    pictures = []
    for k in range(frames):
        x, y = path_px[k]
        matrix = np.array([[1.0, 0.0, x - 10.0], [0.0, 1.0, y - 10.0]])
        picture = cv2.warpAffine(WALL, matrix, (SIDE, SIDE), flags=cv2.INTER_LINEAR)
        middle = SIDE / 2 + 12 * np.sin(0.4 * k) + x
        disk = (columns - middle) ** 2 + (rows - 40 - y) ** 2 < 36
        picture[disk] = 10.0
        pictures.append(np.round(picture).astype(np.uint8))
    return Recording(
        frames=np.stack(pictures),
        time_s=np.arange(frames) / 30.0,
        inputs=np.zeros((frames, 0)),
        input_names=(),
        input_units=(),
        meta={"origin": "filmed", "source": "disk", "sha256": "1", "licence": "none"},
        n_train=frames // 2,
    )


def still(shift=(0.0, 0.0), frames=60):
    return np.tile(np.asarray(shift, dtype=float), (frames, 1))


@pytest.fixture(scope="module")
def reader():
    """An encoder and its chart of the still film; untrained, and a shift moves its latents all the same."""
    model = tiny_run.autoencoder(1, SIDE)
    return model, tiny_run.chart(model, film(still()))


def test_a_camera_that_stood_still_is_not_told_of(reader):
    shift = measure_camera_shift(film(still()), film(still()), *reader)
    assert shift.still_within
    assert shift.still_between
    assert shift.share == 0.0
    assert check_camera(shift, source="film") == []


def test_a_camera_moved_since_the_nominal_film_is_measured(reader):
    shift = measure_camera_shift(film(still((2.0, -1.0))), film(still()), *reader)
    np.testing.assert_allclose(shift.between_px, (2.0, -1.0), atol=0.15)
    assert shift.within_px < 0.1
    assert shift.still_within
    assert not shift.still_between
    assert shift.share > 0.0
    (found,) = check_camera(shift, source="film.mp4")
    assert found.level == "warn"
    assert "since the recording" in found.text
    assert "during" not in found.text


def test_a_camera_that_drifts_during_the_film_is_measured(reader):
    path = np.linspace(0.0, 3.0, 60)[:, None] * np.array([1.0, 0.0])
    shift = measure_camera_shift(film(path), film(still()), *reader)
    # rms about the mean of a ramp of 3 px is 3 / sqrt(12)
    np.testing.assert_allclose(shift.within_px, 3.0 / np.sqrt(12.0), rtol=0.1)
    assert "during the recording" in check_camera(shift, source="film")[0].text


def footage(**found):
    none = {"camera": None, "flicker": None, "cuts": [], "repeat": None, "visit": None, "sampling": None}
    return none | {"camera_limit_px": 1.0, "start_s": 0.0, "stop_s": 2.0, "warnings": []} | found


def with_footage(**found):
    whole = film(still())
    return replace(whole, meta={**whole.meta, "footage": [footage(**found)]})


def test_a_whole_film_stays_whole():
    recording = with_footage()
    assert drop_unusable_frames(recording) == (recording, [])


def test_a_cut_parts_a_film_and_nothing_is_lost():
    recording, (found,) = drop_unusable_frames(with_footage(cuts=[{"time_s": 1.0, "ratio": 9.0}]))
    assert recording.segments == ((0, 30), (30, 60))
    assert found.check == "cut"
    assert "1.000 s" in found.what


def test_visitors_and_repetitions_are_left_out():
    seen = {"gone_s": 0.5, "back_s": None, "share": 0.2}
    again = {"start_s": 1.5, "stop_s": 2.0, "original_s": 0.6}
    recording, findings = drop_unusable_frames(with_footage(visit=seen, repeat=again))
    assert (recording.time_s[0], recording.n_frames) == (0.5, 30)
    assert {found.check for found in findings} == {"visitor", "repetition"}


def test_what_would_leave_nothing_is_told_and_not_done():
    seen = {"gone_s": 1.9, "back_s": None, "share": 0.2}
    recording, findings = drop_unusable_frames(with_footage(visit=seen))
    assert recording.n_frames == 60
    assert len(findings) == 1


def test_other_warnings_of_a_film_become_findings():
    said = (
        "only 5.0 frames a period of 0.16 s; velocities from so few are poor, and 8 or more are wanted. "
        "Film with a higher frame rate",
        "the exposure flickers by 4.0 % rms, mostly at 3.00 Hz; above 2 % colours change more than they are "
        "learned to. Lock the camera's exposure, or cut to a steady part with recording.skip_s and end_s",
    )
    _, findings = drop_unusable_frames(with_footage(warnings=said))
    assert [found.check for found in findings] == ["flicker", "sampling"]
    assert findings[1].what.startswith("only 5.0 frames a period")
