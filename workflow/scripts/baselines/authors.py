"""Frames that the authors' own tool predicts, from a checkout of the user's or read from a folder."""

from pathlib import Path

from lagsplat.baselines.config import AuthorsConfig
from lagsplat.baselines.gaussian_prediction import predict_frames
from lagsplat.io.files.artifact import save_artifact
from lagsplat.io.recording.recording import load_recording
from lagsplat.io.recording.segments import find_crossing_frames
from lagsplat.planning.job import Job

with Job(snakemake) as job:
    recording = load_recording(job.input.recording)
    start, boundary, stop = find_crossing_frames(recording.segments, recording.split()[0].n_frames)
    frames = predict_frames(
        recording.frames[start:stop],
        job.section(AuthorsConfig),
        n_train=boundary - start,
        place=Path(job.params.place),
        say=job.say,
    )
    save_artifact(job.output.frames, {"frames": frames}, {"kind": "predicted", "schema": 1, **job.header})
