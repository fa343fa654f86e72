"""A real video, read like the recording that a run was fitted to."""

import itertools
import warnings
from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lagsplat.diagnose.core.result import Finding
from lagsplat.diagnose.imaging.video_checks import drop_unusable_frames
from lagsplat.io.config import McapConfig, McapInputConfig, RecordingConfig, SplitConfig
from lagsplat.io.files.artifact import read_header
from lagsplat.io.files.atomic import load_json
from lagsplat.io.read import read_recording
from lagsplat.io.recording.inputs import add_inputs
from lagsplat.io.recording.recording import Recording, load_recording
from lagsplat.io.sources import VIDEO_KINDS, DataSource
from lagsplat.io.video.read import SAME_SHAPE


def read_real_video(
    source: DataSource, own: Recording, settings: Mapping[str, Any], *, dt_s: float
) -> tuple[Recording, list[Finding]] | None:
    """Read a real video as a run's ``own`` recording was read; None where it is that very recording.

    Frames that cannot be used are left out, with a finding. Inputs are those of the video or of the table
    beside it. ``settings`` are those of the run's own recording, see `read_fitted_settings`, and ``dt_s`` is
    its spacing of frames [s].

    Raises:
        FileNotFoundError: no file.
        ValueError: no video, one that cannot be read, a log while the run was not fitted to one, images of
            another size, or fewer inputs.
    """
    if source.kind not in VIDEO_KINDS:
        raise ValueError(
            f"{source.path}: a {source.kind} has no trajectory to compare a run with; name a video, a log or "
            "a table of its latents"
        )
    recording = _read_video(source, own, settings, dt_s=dt_s)
    if recording.meta.get("sha256") == own.meta.get("sha256"):
        return None
    _check_pictures(source, recording, own)
    recording, findings = drop_unusable_frames(recording)
    if source.inputs:
        recording = add_inputs(recording, source.inputs)
    check_inputs(source.path, recording.inputs.shape[1], own.inputs.shape[1])
    return recording, findings


def _read_video(source: DataSource, own: Recording, settings: Mapping[str, Any], *, dt_s: float) -> Recording:
    if source.kind == "recording":
        return load_recording(source.path)
    with warnings.catch_warnings(record=True) as caught:
        warnings.simplefilter("always")
        recording = read_recording(_derive_settings(source, settings, own, dt_s=dt_s))
    footage = recording.meta.get("footage") or []
    known = [sentence for clip in footage for sentence in clip["warnings"]]
    for warning in caught:  # warnings about the video become findings
        if not any(str(warning.message).endswith(sentence) for sentence in known):
            warnings.warn(str(warning.message), warning.category, stacklevel=5)
    return recording


def _check_pictures(source: DataSource, recording: Recording, own: Recording) -> None:
    """Check that images have the run's size, and their film the shape of the run's film before resizing."""
    size, expected = recording.frames.shape[1:3], own.frames.shape[1:3]
    if size != expected:
        raise ValueError(
            f"{source.path}: images of {size[0]} x {size[1]} px, but the run was fitted to {expected[0]} x "
            f"{expected[1]}; give a recording that was read as the run's own was"
        )
    pictures, own_pictures = (
        [clip["picture_px"] for clip in each.meta.get("clips") or () if "picture_px" in clip]
        for each in (recording, own)
    )
    for (rows, columns), (own_rows, own_columns) in itertools.product(pictures, own_pictures):
        if own.meta.get("crop") is None:
            same = abs(columns * own_rows / (rows * own_columns) - 1.0) <= SAME_SHAPE
        else:
            same = (rows, columns) == (own_rows, own_columns)
        if not same:
            raise ValueError(
                f"{source.path}: a film of {columns} x {rows} px (width x height), but the sim's has "
                f"{own_columns} x {own_rows}; film both alike, or cut both to the same part of the scene"
            )


def check_inputs(source: str, n_u: int, expected: int) -> None:
    """Check that a recording has the inputs of the run that it is compared with.

    Raises:
        ValueError: it has fewer.
    """
    if n_u < expected:
        raise ValueError(
            f"{source}: {n_u} input(s), but the run was fitted with {expected}; give the inputs in a CSV "
            "of the same stem with columns t, u0, ..., with zeros if nothing acted"
        )


def _derive_settings(
    source: DataSource, settings: Mapping[str, Any], own: Recording, *, dt_s: float
) -> RecordingConfig:
    """The settings by which images are rotated, cropped, resized and stabilised as for the run."""
    from_images = source.kind != "krauss"
    meta = own.meta if from_images else {}
    return RecordingConfig(
        kind=source.kind,
        path=source.path,
        archive=None,
        member=None,
        dt_s=_derive_spacing(source, settings, dt_s),
        n_inputs=0 if from_images else own.inputs.shape[1],
        rotate=int(meta.get("rotate", 0)),
        stabilise=bool(meta.get("stabilise", False)) and source.kind == "video",
        grey=bool(meta.get("grey", False)),
        crop=meta.get("crop"),
        skip_s=0.0,
        end_s=None,
        spans_s=None,
        height=own.height if from_images else None,
        width=own.width if from_images else None,
        split=SplitConfig(0.5, None, None),
        mcap=_derive_topics(source, settings) if source.kind == "mcap" else None,
    )


def _derive_topics(source: DataSource, settings: Mapping[str, Any]) -> McapConfig:
    """The run's topics of a log."""
    topics = settings.get("mcap") or {}
    if not topics.get("camera"):
        raise ValueError(
            f"{source.path}: the run was not fitted to a log, so that nothing says which topics hold "
            "images and inputs; export the camera as a video, with its inputs in a CSV of the same stem"
        )
    return McapConfig(**{**topics, "inputs": [McapInputConfig(**each) for each in topics["inputs"]]})


def _derive_spacing(source: DataSource, settings: Mapping[str, Any], dt_s: float) -> float | None:
    """Seconds between frames of files without times: archives, and images without a table of times."""
    if source.kind == "krauss":
        return settings.get("dt_s") or dt_s
    return settings.get("dt_s") if Path(source.path).is_dir() and settings.get("kind") == "video" else None


def read_fitted_settings(folder: Path) -> dict[str, Any]:
    """Settings of the own recording of the run in ``folder``, as far as its files hold them."""
    for place in (folder, *folder.resolve().parents[:2]):
        if (place / "dynamics.safetensors").is_file():
            header = read_header(place / "dynamics.safetensors")
            if "config" in header:
                return dict(header["config"]["recording"])
        if (place / "recording.json").is_file():
            return dict(load_json(place / "recording.json")["settings"].get("cfg") or {})
    return {}
