"""Settings of a recording: every domain check, and that OmegaConf can fill them."""

from typing import Any

import pytest
from omegaconf import OmegaConf
from omegaconf.errors import ConfigKeyError, MissingMandatoryValue

from lagsplat.io.config import ArchiveConfig, RecordingConfig, SplitConfig

VIDEO = {
    "kind": "video",
    "path": "film.mp4",
    "archive": None,
    "member": None,
    "dt_s": None,
    "n_inputs": 0,
    "rotate": 0,
    "stabilise": False,
    "grey": False,
    "crop": [0, 0, 250, 360],
    "skip_s": 1.5,
    "end_s": None,
    "spans_s": None,
    "height": 92,
    "width": 64,
    "split": SplitConfig(train_fraction=0.8, held_out_frames=None, held_out_clips=None),
    "mcap": None,
}
KRAUSS = {
    **VIDEO,
    "kind": "krauss",
    "dt_s": 0.0167,
    "crop": None,
    "skip_s": 0.0,
    "height": None,
    "width": None,
}
INPUT = {"topic": "/joints", "field": "position[elbow]", "name": "elbow", "unit": "rad"}
MCAP = {"camera": "/camera", "inputs": [INPUT], "clock": "header", "max_gap_s": 0.5}
LOG = {**VIDEO, "kind": "mcap", "mcap": MCAP}
LEROBOT = {
    "camera": "observation.images.front",
    "inputs": ["action"],
    "episodes": [0],
    "joint_unit": "degree",
}
DATASET = {**VIDEO, "kind": "lerobot", "lerobot": LEROBOT}
ARCHIVE = {
    "url": "https://example.org/a.zip",
    "folder": "~",
    "licence": "CC0",
    "archive_sha256": None,
    "member_sha256": {"a.npz": "0" * 64},
}


def fill(values: dict[str, Any]) -> Any:
    return OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(RecordingConfig), values))


def test_omegaconf_fills_and_checks_types() -> None:
    assert fill(VIDEO) == RecordingConfig(**VIDEO)  # type: ignore[arg-type]
    assert fill({**KRAUSS, "archive": ARCHIVE}).archive == ArchiveConfig(**ARCHIVE)  # type: ignore[arg-type]
    assert fill(LOG).mcap.inputs[0].field == "position[elbow]"
    assert fill(DATASET).lerobot.inputs == ["action"]
    with pytest.raises(ConfigKeyError, match="skipp_s"):
        fill({**VIDEO, "skipp_s": 1.0})
    with pytest.raises(MissingMandatoryValue, match="n_inputs"):
        fill({key: value for key, value in VIDEO.items() if key != "n_inputs"})


@pytest.mark.parametrize(
    ("values", "message"),
    [
        ({**VIDEO, "kind": "gif"}, "kind=gif must be one of simulated, krauss, video, mcap, lerobot"),
        ({**LOG, "mcap": None}, r"mcap\.camera=None must name the topic"),
        ({**LOG, "mcap": {**MCAP, "camera": None}}, r"mcap\.camera=None must name the topic"),
        ({**LOG, "mcap": {**MCAP, "clock": "wall"}}, "clock=wall must be one of header, log"),
        ({**LOG, "mcap": {**MCAP, "max_gap_s": 0.0}}, r"max_gap_s=0\.0 must be positive"),
        ({**LOG, "mcap": {**MCAP, "inputs": [INPUT, INPUT]}}, "a name of its own"),
        ({**LOG, "mcap": {**MCAP, "inputs": [{**INPUT, "field": "a[0"}]}}, r"'a\[0' is no path of a field"),
        ({**LOG, "mcap": {**MCAP, "inputs": [{**INPUT, "field": ""}]}}, "'' is no path of a field"),
        ({**LOG, "mcap": {**MCAP, "inputs": [{**INPUT, "topic": ""}]}}, "must not be empty"),
        ({**DATASET, "lerobot": None}, "lerobot=None must name the camera"),
        ({**DATASET, "stabilise": True}, "stabilise=True is for films alone"),
        ({**DATASET, "lerobot": {**LEROBOT, "joint_unit": "turn"}}, "joint_unit=turn must be one of degree"),
        ({**DATASET, "lerobot": {**LEROBOT, "inputs": ["a", "a"]}}, "must each be given once"),
        ({**VIDEO, "n_inputs": -1}, "n_inputs=-1 must be at least 0"),
        ({**VIDEO, "rotate": 45}, "rotate=45 must be one of"),
        ({**KRAUSS, "rotate": 90}, "a Krauss archive is used whole"),
        ({**KRAUSS, "stabilise": True}, "a Krauss archive is used whole"),
        ({**KRAUSS, "grey": True}, "a Krauss archive is used whole"),
        ({**VIDEO, "crop": [0, 0, 250]}, r"crop=\[0, 0, 250\] must be"),
        ({**VIDEO, "crop": [-1, 0, 250, 360]}, "crop="),
        ({**VIDEO, "crop": [0, 0, 0, 360]}, "crop="),
        ({**VIDEO, "skip_s": -0.1}, r"skip_s=-0\.1 must be at least 0"),
        ({**VIDEO, "spans_s": [[1.0]]}, r"spans_s=\[\[1\.0\]\] must be"),
        ({**VIDEO, "spans_s": []}, r"spans_s=\[\] must be"),
        ({**VIDEO, "end_s": 1.5}, r"end_s=1\.5 must be after skip_s=1\.5"),
        ({**VIDEO, "width": None}, "height=92 and width=None must both be"),
        ({**VIDEO, "height": 0}, r"must both be 1 or more \[pixel\]"),
        ({**KRAUSS, "dt_s": None}, "dt_s=None but a Krauss archive carries no timestamps"),
        ({**KRAUSS, "dt_s": 0.0}, r"dt_s=0\.0 must be above 0"),
        ({**KRAUSS, "skip_s": 1.0}, r"skip_s=1\.0 must be .*: a Krauss archive is used whole"),
        ({**KRAUSS, "archive": {**ARCHIVE, "url": "a.zip"}}, "url=a.zip must start with"),
        (
            {**KRAUSS, "archive": {**ARCHIVE, "archive_sha256": "abc"}},
            "=abc is no SHA-256 of 'archive_sha256': it must have 64",
        ),
        (
            {**KRAUSS, "archive": {**ARCHIVE, "member_sha256": {"a.npz": "F" * 64}}},
            "F is no SHA-256 of 'a.npz'",
        ),
    ],
)
def test_values_outside_their_domain(values: dict, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        fill(values)
