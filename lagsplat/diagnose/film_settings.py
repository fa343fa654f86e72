"""How another film, log or archive is read for a run: as its own recording was, less the cuts in time."""

from collections.abc import Mapping
from pathlib import Path
from typing import Any

from lagsplat.diagnose.sources import Source
from lagsplat.io.artefact import read_header
from lagsplat.io.config import McapConfig, McapInputConfig, RecordingConfig, SplitConfig
from lagsplat.io.plain import load_json
from lagsplat.io.recording import Recording


def settings_for(source: Source, folder: Path, own: Recording, *, dt_s: float) -> RecordingConfig:
    """Settings by which ``source`` is read for the run in ``folder``, which was fitted to ``own``.

    Pictures are turned, cropped, resized and stabilised alike. Archives without times
    take the spacing that was set for the run's own, or ``dt_s``.

    Raises:
        ValueError: a log, while the run was not fitted to one.
    """
    meta, filmed = own.meta, source.kind != "krauss"
    said = _said(folder)
    return RecordingConfig(
        kind=source.kind,
        path=source.path,
        archive=None,
        member=None,
        dt_s=_spacing(source, said, dt_s),
        n_inputs=0 if filmed else own.inputs.shape[1],
        rotate=int(meta.get("rotate", 0)) if filmed else 0,
        stabilise=bool(meta.get("stabilise", False)) and source.kind == "video",
        grey=bool(meta.get("grey", False)) if filmed else False,
        crop=meta.get("crop") if filmed else None,
        skip_s=0.0,
        end_s=None,
        spans_s=None,
        height=own.height if filmed else None,
        width=own.width if filmed else None,
        split=SplitConfig(0.5, None, None),
        mcap=_topics(source, said) if source.kind == "mcap" else None,
    )


def _topics(source: Source, said: Mapping[str, Any]) -> McapConfig:
    topics = said.get("mcap") or {}
    if not topics.get("camera"):
        raise ValueError(
            f"{source.path}: the run was not fitted to a log, so that nothing says which topics hold "
            "pictures and inputs; export the camera as a film, with its inputs in a CSV of the same stem"
        )
    return McapConfig(**{**topics, "inputs": [McapInputConfig(**each) for each in topics["inputs"]]})


def _spacing(source: Source, said: Mapping[str, Any], dt_s: float) -> float | None:
    """Seconds between frames of files without times: archives, and images without a table of times."""
    if source.kind == "krauss":
        return said.get("dt_s") or dt_s
    return said.get("dt_s") if Path(source.path).is_dir() and said.get("kind") == "video" else None


def _said(folder: Path) -> dict[str, Any]:
    """What was set for the run's own recording, as far as its files tell."""
    for place in (folder, *folder.resolve().parents[:2]):
        if (place / "dynamics.safetensors").is_file():
            header = read_header(place / "dynamics.safetensors")
            if "config" in header:
                return dict(header["config"]["recording"])
        if (place / "recording.json").is_file():
            return dict(load_json(place / "recording.json")["settings"].get("cfg") or {})
    return {}
