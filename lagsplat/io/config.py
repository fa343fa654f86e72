"""Settings of a recording's source: the typed form of ``conf/recording/*.yaml``.

``kind`` chooses the source: ``simulated`` (drawn by ``lagsplat.systems``; every field except ``split`` is
unused), ``krauss`` (an NPZ archive with ``images`` and ``p1..pn``), ``video`` (any video OpenCV can open, or
images), ``mcap`` (a robot's log with a camera, an MCAP file or a ROS 2 bag, see `McapConfig`) or ``lerobot``
(a dataset of LeRobot, see `LerobotConfig`). ``path`` is the user's file or folder. A Krauss recording without
``path`` is downloaded from ``archive``.
"""

import re
from dataclasses import dataclass

from lagsplat.setting_checks import require_least, require_positive, require_setting

KINDS = ("simulated", "krauss", "video", "mcap", "lerobot")
TURNS = (0, 90, 180, 270)
CLOCKS = ("header", "log")
JOINT_UNITS = ("degree", "radian", "as_written")
FIELD_PATH = re.compile(r"[^.\[\]]+(\[[^\[\]]+\])*(\.[^.\[\]]+(\[[^\[\]]+\])*)*")


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class ArchiveConfig:
    """A public zip archive and the members to extract."""

    url: str
    folder: str  # keeps the archive and its extracted members; ~ is the home folder
    licence: str
    archive_sha256: str | None  # null if the publisher gives none: the members are always checked
    member_sha256: dict[str, str]  # SHA-256 of each member by its path inside the archive

    def __post_init__(self) -> None:
        is_address = self.url.startswith(("http://", "https://"))
        require_setting("recording.archive.url", self.url, is_address, "must start with https://")
        for name, digest in {**self.member_sha256, "archive_sha256": self.archive_sha256 or "0" * 64}.items():
            rule = f"is no SHA-256 of {name!r}: it must have 64 hexadecimal digits in lower case"
            is_digest = re.fullmatch("[0-9a-f]{64}", digest) is not None
            require_setting("recording.archive", digest, is_digest, rule)


@dataclass  # not frozen, for the same reason
class SplitConfig:
    """What is held out of every fit: exactly one of three is set, the others are null."""

    train_fraction: float | None  # train on this leading share of all frames
    held_out_frames: int | None  # train on all but the last so many frames
    held_out_clips: int | None  # train on all but the last so many clips

    def __post_init__(self) -> None:
        given = {name: value for name, value in vars(self).items() if value is not None}
        rule = "must have exactly one that is not null"
        require_setting("recording.split", vars(self), len(given) == 1, rule)
        ((name, value),) = given.items()
        require_setting(f"recording.split.{name}", value, value > 0, "must be above 0: hold something out")
        if name == "train_fraction":
            rule = "must be below 1, so that both parts hold frames"
            require_setting("recording.split.train_fraction", value, value < 1.0, rule)


@dataclass  # not frozen, for the same reason
class McapInputConfig:
    """One number of a log that drives the mechanism."""

    topic: str
    field: str  # path inside a message: wrench.force.x, data[2], or by joint name position[elbow]
    name: str  # of the recording's input
    unit: str

    def __post_init__(self) -> None:
        key, named = "recording.mcap.inputs", bool(self.topic and self.name)
        require_setting(key, (self.topic, self.name), named, "are a topic and a name; they must not be empty")
        rule = "is no path of a field; write names with dots and brackets, wrench.force.x or position[elbow]"
        require_setting(key, repr(self.field), FIELD_PATH.fullmatch(self.field) is not None, rule)


@dataclass  # not frozen, for the same reason
class McapConfig:
    """How to read a recording from an MCAP file or a ROS 2 bag.

    A gap longer than ``max_gap_s`` [s] in the camera or an input is never bridged: frames inside it are
    dropped and the recording is cut into clips there.
    """

    camera: str | None  # topic of the images, null if the recording is no log
    inputs: list[McapInputConfig]  # interpolated linearly to the frames
    clock: str  # header (the stamps in the messages) or log (the time of writing)
    max_gap_s: float

    def __post_init__(self) -> None:
        known = self.clock in CLOCKS
        require_setting("recording.mcap.clock", self.clock, known, f"must be one of {', '.join(CLOCKS)}")
        require_positive(self, "recording.mcap", "max_gap_s")
        names = [each.name for each in self.inputs]
        unique = len(set(names)) == len(names)
        require_setting("recording.mcap.inputs", names, unique, "must each have a name of its own")


@dataclass  # not frozen, for the same reason
class LerobotConfig:
    """How to read a recording from a LeRobot dataset."""

    camera: str | None  # feature of the pictures, null if the recording is no LeRobot dataset
    inputs: list[str]  # features, action for all its numbers, or single numbers, action.elbow_flex.pos
    episodes: list[int] | None  # null for all
    joint_unit: str | None  # one of `JOINT_UNITS`; null decides by a rule (`lagsplat.io.lerobot.units`)

    def __post_init__(self) -> None:
        unit, named = self.joint_unit, len(set(self.inputs)) == len(self.inputs) and all(self.inputs)
        require_joint_unit("recording.lerobot.joint_unit", unit)
        require_setting("recording.lerobot.inputs", self.inputs, named, "must each be given once, by a name")


def require_joint_unit(name: str, unit: str | None) -> None:
    """Raise a ValueError unless the setting ``name`` is one of `JOINT_UNITS` or None."""
    rule = f"must be one of {', '.join(JOINT_UNITS)}, or null"
    require_setting(name, unit, unit is None or unit in JOINT_UNITS, rule)


@dataclass  # not frozen, for the same reason
class RecordingConfig:
    """One recording: the kind of source, its file, and the part to keep."""

    kind: str
    path: str | None  # a file, for videos also a folder: each video in it is a clip, or all images are one
    archive: ArchiveConfig | None
    member: str | None  # of the archive, used when path is null
    dt_s: float | None  # spacing of frames without times (Krauss NPZ, images); null for a video
    n_inputs: int  # number of pressure channels
    rotate: int  # clockwise [degree], on top of the file's own rotation
    stabilise: bool  # shift images back onto the first by the motion of the background
    grey: bool  # drop the colours
    crop: list[int] | None  # (x, y, width, height) [pixel of the rotated video]; null for the whole image
    skip_s: float  # start [s from the first frame]
    end_s: float | None  # end, exclusive [s from the first frame]; null keeps everything to the end
    spans_s: list[list[float]] | None  # keep only these [start, stop] [s from the first frame kept] as clips
    height: int | None  # after resizing [pixel]; null to keep the cropped size
    width: int | None
    split: SplitConfig
    mcap: McapConfig | None  # topics of a log; its inputs replace n_inputs
    lerobot: LerobotConfig | None = None  # camera of a LeRobot dataset; its inputs replace n_inputs

    def __post_init__(self) -> None:
        self._check_kind()
        require_least(self, "recording", 0, "n_inputs", "skip_s")
        crop, dt_s, sides = self.crop, self.dt_s, (self.height, self.width)
        rules = {
            "dt_s": (dt_s is None or 0.0 < dt_s < float("inf"), "must be above 0 [s]"),
            "rotate": (self.rotate in TURNS, f"must be one of {TURNS} [degree clockwise]"),
            "crop": (
                crop is None or (len(crop) == 4 and min(crop[:2]) >= 0 and min(crop[2:]) >= 1),
                "must be [x, y, width, height] in pixels, or null",
            ),
            "end_s": (self.end_s is None or self.end_s > self.skip_s, f"must be after skip_s={self.skip_s}"),
            "spans_s": (
                self.spans_s is None or all(len(span) == 2 for span in self.spans_s or [[]]),
                "must be [[start, stop], ...] [s], or null",
            ),
            "height": (
                sides == (None, None) or min(side or 0 for side in sides) >= 1,
                f"and width={self.width} must both be 1 or more [pixel], or both null",
            ),
        }
        for name, (holds, rule) in rules.items():
            require_setting(f"recording.{name}", getattr(self, name), holds, rule)

    def _check_kind(self) -> None:
        known = self.kind in KINDS
        require_setting("recording.kind", self.kind, known, f"must be one of {', '.join(KINDS)}")
        if self.kind == "krauss":
            rule = "but a Krauss archive carries no timestamps; the published ones have 1001/60000 [s]"
            require_setting("recording.dt_s", None, self.dt_s is not None, rule)
            rule = "must be null, 0 or false: a Krauss archive is used whole"
            for name in ("rotate", "stabilise", "grey", "crop", "skip_s", "end_s", "height", "width"):
                require_setting(f"recording.{name}", getattr(self, name), not getattr(self, name), rule)
        if self.kind == "mcap":
            rule = "needs a film: export the camera's topic as one, or set it to false"
            require_setting("recording.stabilise", True, not self.stabilise, rule)
            rule = "must name the topic of the pictures; `lagsplat inspect FILE` lists them"
            camera = None if self.mcap is None else self.mcap.camera
            require_setting("recording.mcap.camera", camera, camera is not None, rule)
        if self.kind == "lerobot":
            rule = "is for films alone; set it to false"
            require_setting("recording.stabilise", True, not self.stabilise, rule)
            require_setting("recording.lerobot", None, self.lerobot is not None, "must name the camera")
