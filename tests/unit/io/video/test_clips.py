"""Which files a path stands for."""

from pathlib import Path

import pytest

from lagsplat.io.video.clips import find_clips


def fill(folder: Path, *names: str) -> Path:
    for name in names:
        (folder / name).touch()
    return folder


def test_films_are_clips_in_the_order_of_their_numbers(tmp_path: Path) -> None:
    fill(tmp_path, "take10.mp4", "take2.MOV", "take1.avi", "notes.txt", "._take1.avi", "times.csv")
    clips = find_clips(tmp_path)
    assert [clip.path.name for clip in clips] == ["take1.avi", "take2.MOV", "take10.mp4"]
    assert all(clip.files == (clip.path,) for clip in clips)


def test_images_are_one_clip(tmp_path: Path) -> None:
    fill(tmp_path, "img10.png", "img9.png", "img100.png")
    (clip,) = find_clips(tmp_path)
    assert [image.name for image in clip.images] == ["img9.png", "img10.png", "img100.png"]
    assert clip.files == clip.images
    (clip,) = find_clips(fill(tmp_path, "times.csv"))
    assert clip.files == (*clip.images, tmp_path / "times.csv")


def test_one_file_is_a_film_whatever_its_name(tmp_path: Path) -> None:
    (clip,) = find_clips(fill(tmp_path, "film.dat") / "film.dat")
    assert clip.files == (tmp_path / "film.dat",)


def test_what_holds_no_recording_is_refused(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"gone: no such file or folder; check recording\.path"):
        find_clips(tmp_path / "gone")
    with pytest.raises(ValueError, match="holds neither a film"):
        find_clips(tmp_path)
    with pytest.raises(ValueError, match=r"holds 1 films \(a\.mp4, \.\.\.\) and 2 images \(b1\.png"):
        find_clips(fill(tmp_path, "a.mp4", "b1.png", "b2.png"))
