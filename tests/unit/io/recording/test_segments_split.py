"""Which frames are held out, and when a division is refused."""

import numpy as np
import pytest

from lagsplat.io.config import SplitConfig
from lagsplat.io.recording.recording import Recording
from lagsplat.io.recording.segments import find_crossing_frames, split_train_held_out


def recording(n: int, *segments: tuple[int, int]) -> Recording:
    return Recording(
        frames=np.broadcast_to(np.uint8(1), (n, 1, 1, 3)),
        time_s=np.arange(n) * 1001 / 60000,
        inputs=np.zeros((n, 0)),
        input_names=(),
        input_units=(),
        segments=segments,
        meta={"origin": "filmed", "source": "twin.npz"},
    )


def share(fraction: float) -> SplitConfig:
    return SplitConfig(train_fraction=fraction, held_out_frames=None, held_out_clips=None)


@pytest.mark.parametrize(
    ("n", "fraction", "n_train"),
    [(20, 0.8, 16), (20, 0.79, 15), (20, 0.15, 3), (20, 0.85, 17), (100, 0.29, 29), (54_840, 0.8, 43_872)],
)
def test_a_share_is_rounded_down(n: int, fraction: float, n_train: int) -> None:
    assert split_train_held_out(recording(n), share(fraction)).n_train == n_train


def test_a_number_of_last_frames_is_held_out() -> None:
    split = SplitConfig(train_fraction=None, held_out_frames=33, held_out_clips=None)
    assert split_train_held_out(recording(133), split).n_train == 100


def test_whole_clips_are_held_out() -> None:
    film = recording(50, (0, 10), (10, 22), (22, 50))
    split = SplitConfig(train_fraction=None, held_out_frames=None, held_out_clips=2)
    train, held_out = split_train_held_out(film, split).split()
    assert (train.segments, held_out.segments) == (((0, 10),), ((0, 12), (12, 40)))


def test_the_last_training_clip_cannot_be_held_out() -> None:
    split = SplitConfig(train_fraction=None, held_out_frames=None, held_out_clips=1)
    with pytest.raises(ValueError, match=r"twin\.npz: 1 clip\(s\), of which held_out_clips = 1 leave none"):
        split_train_held_out(recording(50), split)


@pytest.mark.parametrize("fraction", [0.05, 0.95])
def test_too_few_frames_for_the_split(fraction: float) -> None:
    with pytest.raises(
        ValueError, match=rf"twin\.npz: frames 20 .*train_fraction = {fraction}; each part needs 3"
    ):
        split_train_held_out(recording(20), share(fraction))


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ((1.0, None, None), r"train_fraction=1\.0 must be below 1"),
        ((0.0, None, None), r"train_fraction=0\.0 must be above 0"),
        ((None, 0, None), "held_out_frames=0 must be above 0"),
        ((None, None, None), "exactly one"),
        ((0.5, None, 1), "exactly one"),
    ],
)
def test_a_split_that_says_nothing_or_two_things_is_refused(
    values: tuple[float | None, int | None, int | None], message: str
) -> None:
    with pytest.raises(ValueError, match=message):
        SplitConfig(*values)


def test_a_forecast_crosses_into_the_held_out_part_of_one_clip() -> None:
    assert find_crossing_frames([(0, 10), (10, 30)], 20) == (10, 20, 30)
    with pytest.raises(ValueError, match="as it begins with a new clip; hold out the end of one"):
        find_crossing_frames([(0, 10), (10, 30)], 10)
