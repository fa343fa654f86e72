"""Read a recording from an MCAP file or a ROS 2 bag.

One camera topic gives the frames, and numbers of other topics are interpolated to them as inputs
(`lagsplat.io.recording.alignment`). Times count from the camera's first message. The intact part of a
damaged log is read, with a warning of what is lost.
"""

import warnings
from contextlib import closing
from pathlib import Path

import numpy as np

from lagsplat.io.config import McapConfig
from lagsplat.io.files.atomic import StrPath
from lagsplat.io.recording.alignment import InputLog, align_log
from lagsplat.io.recording.recording import Recording
from lagsplat.io.robot_log.images import CameraReader
from lagsplat.io.robot_log.storage import hash_log
from lagsplat.io.robot_log.topics import OF_RECORDING, TopicLog
from lagsplat.video_quality.assessment import assess_video
from lagsplat.video_quality.frames import FrameSettings


def read_log(path: StrPath, topics: McapConfig, settings: FrameSettings) -> Recording:
    """Read the recording in the MCAP file or bag at ``path``.

    Dropped, each with a warning that counts them: repeated stamps, images that cannot be decoded, numbers
    that are not finite, and frames outside the inputs or in a gap.

    Raises:
        FileNotFoundError: there is no file at ``path``.
        ValueError: the file is no log; a topic is missing, empty or of another type; a field does not
            exist; a clock jumps backwards; an encoding or codec is unknown; camera and inputs do not
            overlap; or no frame is left.
    """
    path = Path(path)
    with closing(CameraReader(str(topics.camera), settings, source=str(path))) as camera:
        fields = [(each.topic, each.field) for each in topics.inputs]
        log = TopicLog(path, fields, OF_RECORDING, clock=topics.clock, camera=camera)
        log.read()
    numbers, frame_s = log.frame_times()
    logs = []
    for each in topics.inputs:
        times_ns, values = log.samples(each.topic, each.field)
        logs.append(InputLog(each.name, (times_ns - camera.start_ns) / 1e9, values))
    aligned = align_log(frame_s, logs, max_gap_s=topics.max_gap_s, source=str(path))
    pictures = [camera.frames.pop(int(number)) for number in numbers[aligned.kept]]
    sizes = {picture.shape[:2] for picture in pictures}
    if len(sizes) > 1:
        problem = f"{path}: the camera's pictures have sizes {sorted(sizes)} (height, width)"
        raise ValueError(f"{problem}; give recording.height and recording.width")
    frames, time_s = np.stack(pictures), frame_s[aligned.kept]
    footage = assess_video(frames, time_s, camera.thumbnails, crop=settings.crop)
    for sentence in footage.warnings:
        warnings.warn(f"{path}: {sentence}", stacklevel=3)
    return Recording(
        frames=frames,
        time_s=time_s,
        inputs=aligned.inputs,
        input_names=tuple(each.name for each in topics.inputs),
        input_units=tuple(each.unit for each in topics.inputs),
        segments=aligned.segments,
        meta={
            "origin": "filmed",
            "source": path.name,
            "sha256": hash_log(path),
            "licence": "unknown",
            "crop": None if settings.crop is None else list(settings.crop),
            "skip_s": settings.skip_s,
            "end_s": settings.end_s,
            "camera": camera.topic,
            "clock": topics.clock,
            "max_gap_s": topics.max_gap_s,
            "start_ns": camera.start_ns,
            "rotate": settings.rotate,
            "grey": settings.grey,
            "clips": [
                {
                    "source": path.name,
                    "frames": len(frames),
                    "start_s": float(time_s[0]),
                    "picture_px": [camera.thumbnails.height, camera.thumbnails.width],
                }
            ],
            "footage": [footage.numbers],
        },
    )
