"""Settings of a recording's source: the typed form of ``conf/recording/*.yaml``.

``kind`` chooses the source: ``simulated`` (drawn by ``lagsplat.systems``; every field except ``split`` is
unused), ``krauss`` (an NPZ archive with ``images`` and ``p1..pn``), ``video`` (any video OpenCV can open, or
images) or ``mcap`` (a robot's log with a camera, see `McapConfig`). ``path`` is the user's file or folder. A
Krauss recording without ``path`` is downloaded from ``archive``.
"""

import re
from dataclasses import dataclass

KINDS = ("simulated", "krauss", "video", "mcap")
TURNS = (0, 90, 180, 270)
CLOCKS = ("header", "log")
FIELD_PATH = re.compile(r"[^.\[\]]+(\[[^\[\]]+\])*(\.[^.\[\]]+(\[[^\[\]]+\])*)*")


@dataclass  # not frozen: OmegaConf turns frozen dataclasses into read-only nodes
class ArchiveConfig:
    """A public zip archive and the members to extract.

    ``folder`` keeps the archive and its extracted members; ``~`` is the home folder. ``archive_sha256`` may
    be null if the publisher gives none: the members are always checked. ``member_sha256`` maps each member's
    path inside the archive to its SHA-256.
    """

    url: str
    folder: str
    licence: str
    archive_sha256: str | None
    member_sha256: dict[str, str]

    def __post_init__(self) -> None:
        if not self.url.startswith(("http://", "https://")):
            raise ValueError(
                f"recording.archive.url is {self.url!r}, not a web address; start it with https://"
            )
        sums = {
            **self.member_sha256,
            **({"archive_sha256": self.archive_sha256} if self.archive_sha256 else {}),
        }
        for name, digest in sums.items():
            if not re.fullmatch("[0-9a-f]{64}", digest):
                raise ValueError(
                    f"recording.archive: the SHA-256 of {name!r} is {digest!r}; "
                    "give 64 hexadecimal digits in lower case"
                )


@dataclass  # not frozen, for the same reason
class SplitConfig:
    """What is held out of every fit: exactly one of three is set, the others are null.

    ``train_fraction`` trains on the leading share of all frames, ``held_out_frames`` on all but the last
    frames, ``held_out_clips`` on all but the last clips.
    """

    train_fraction: float | None
    held_out_frames: int | None
    held_out_clips: int | None

    def __post_init__(self) -> None:
        given = {name: value for name, value in vars(self).items() if value is not None}
        if len(given) != 1:
            raise ValueError(
                f"recording.split is {vars(self)}; give exactly one of train_fraction, held_out_frames and "
                "held_out_clips, and null for the others"
            )
        name, value = next(iter(given.items()))
        if name == "train_fraction" and not 0.0 < value < 1.0:
            raise ValueError(
                f"recording.split.train_fraction is {value}; it must lie strictly between 0 and 1, "
                "so that both parts hold frames"
            )
        if value <= 0:
            raise ValueError(f"recording.split.{name} is {value}; hold out at least one")


@dataclass  # not frozen, for the same reason
class McapInputConfig:
    """One number of a log that drives the mechanism.

    ``field`` is its path inside a message of ``topic``: ``wrench.force.x``, ``data[2]``, or by joint name,
    ``position[elbow]``. ``name`` and ``unit`` are those of the recording's input.
    """

    topic: str
    field: str
    name: str
    unit: str

    def __post_init__(self) -> None:
        if not self.topic or not self.name:
            raise ValueError(
                f"recording.mcap.inputs: topic {self.topic!r} and name {self.name!r} must not be empty"
            )
        if not FIELD_PATH.fullmatch(self.field):
            raise ValueError(
                f"recording.mcap.inputs: field {self.field!r} is no path; write names with dots and indices "
                "in brackets, such as wrench.force.x, data[2] or position[elbow]"
            )


@dataclass  # not frozen, for the same reason
class McapConfig:
    """How to read a recording from an MCAP file.

    ``camera`` is the topic of the images, null if the recording is no MCAP file. ``inputs`` are interpolated
    linearly to the frames. ``clock`` is ``header`` (the stamps in the messages) or ``log`` (the time of
    writing). A gap longer than ``max_gap_s`` [s] in the camera or an input is never bridged: frames inside
    it are dropped and the recording is cut into clips there.
    """

    camera: str | None
    inputs: list[McapInputConfig]
    clock: str
    max_gap_s: float

    def __post_init__(self) -> None:
        if self.clock not in CLOCKS:
            raise ValueError(f"recording.mcap.clock is {self.clock!r}; choose one of {', '.join(CLOCKS)}")
        if not self.max_gap_s > 0.0:
            raise ValueError(f"recording.mcap.max_gap_s is {self.max_gap_s}; give seconds, above 0")
        names = [each.name for each in self.inputs]
        if len(set(names)) < len(names):
            raise ValueError(f"recording.mcap.inputs are named {names}; give each a name of its own")


@dataclass  # not frozen, for the same reason
class RecordingConfig:
    """One recording: the kind of source, its file, and the part to keep.

    ``path`` is a file, or for videos also a folder: each video in it is a clip, or all images together are
    one. ``dt_s`` is the frame spacing of files without timestamps (Krauss NPZ, images); null for a video,
    which has its own. ``member`` names the archive's member used when ``path`` is null. ``n_inputs`` is the
    number of pressure channels. ``rotate`` turns a video clockwise [degree], on top of the file's own
    rotation. ``stabilise`` shifts its images back onto the first by the motion of the background. ``grey``
    drops its colours. ``crop`` is (x, y, width, height) in pixels of the rotated video, null for the whole
    image. ``skip_s`` and ``end_s`` cut the video [s from its first frame]; a null ``end_s`` keeps everything
    to the end. ``spans_s`` keeps only these [start, stop] [s from the first frame kept], each as a clip.
    ``height`` and ``width`` are the size after resizing [pixel], both null to keep the cropped size.
    ``split`` says what is held out. ``mcap`` gives the topics of an MCAP file; its inputs replace
    ``n_inputs``.
    """

    kind: str
    path: str | None
    archive: ArchiveConfig | None
    member: str | None
    dt_s: float | None
    n_inputs: int
    rotate: int
    stabilise: bool
    grey: bool
    crop: list[int] | None
    skip_s: float
    end_s: float | None
    spans_s: list[list[float]] | None
    height: int | None
    width: int | None
    split: SplitConfig
    mcap: McapConfig | None

    def __post_init__(self) -> None:
        if self.kind not in KINDS:
            raise ValueError(f"recording.kind is {self.kind!r}; choose one of {', '.join(KINDS)}")
        if self.n_inputs < 0:
            raise ValueError(f"recording.n_inputs is {self.n_inputs}; give 0 for an autonomous system")
        if self.dt_s is not None and not 0.0 < self.dt_s < float("inf"):
            raise ValueError(f"recording.dt_s is {self.dt_s}; give the spacing of frames in seconds, above 0")
        if self.kind == "krauss" and self.dt_s is None:
            raise ValueError(
                "recording.dt_s is null, but a Krauss archive carries no timestamps; "
                "give the spacing of frames in seconds (1001/60000 for the published ones)"
            )
        treated = self.rotate or self.stabilise or self.grey
        if self.kind == "krauss" and (self.crop or self.skip_s or self.end_s or self.height or treated):
            raise ValueError(
                "recording.crop, skip_s, end_s, height and width cut a film, and rotate, stabilise and grey "
                "change its pictures; a Krauss archive is used whole. Set crop, end_s, height and width to "
                "null, skip_s and rotate to 0, stabilise and grey to false"
            )
        if self.kind == "mcap" and self.stabilise:
            raise ValueError(
                "recording.stabilise needs a film; export the camera's topic as one, or set it to false"
            )
        if self.kind == "mcap" and (self.mcap is None or self.mcap.camera is None):
            raise ValueError(
                "recording.mcap.camera is null; name the topic of the pictures, `lagsplat inspect FILE.mcap` "
                "lists them"
            )
        self._check_cut()

    def _check_cut(self) -> None:
        if self.rotate not in TURNS:
            raise ValueError(f"recording.rotate is {self.rotate}; choose one of {TURNS} degrees clockwise")
        if self.crop is not None and (
            len(self.crop) != 4 or min(self.crop[:2]) < 0 or min(self.crop[2:]) < 1
        ):
            raise ValueError(f"recording.crop is {self.crop}; give [x, y, width, height] in pixels, or null")
        if self.skip_s < 0.0:
            raise ValueError(
                f"recording.skip_s is {self.skip_s}; give seconds from the first frame, 0 or more"
            )
        if self.spans_s is not None and not all(len(span) == 2 for span in self.spans_s or [[]]):
            raise ValueError(f"recording.spans_s is {self.spans_s}; give [[start, stop], ...] [s], or null")
        if self.end_s is not None and self.end_s <= self.skip_s:
            raise ValueError(
                f"recording.end_s is {self.end_s}, not after skip_s = {self.skip_s}; nothing would be left"
            )
        if (self.height is None) != (self.width is None):
            raise ValueError(
                f"recording.height is {self.height} and width is {self.width}; give both, or null for both"
            )
        if self.height is not None and self.width is not None and min(self.height, self.width) < 1:
            raise ValueError(
                f"recording.height x width is {self.height} x {self.width}; give at least one pixel each"
            )
