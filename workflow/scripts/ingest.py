"""Read and check a film or a published archive."""

from lagsplat.io.config import RecordingConfig
from lagsplat.io.read import read_recording
from lagsplat.io.recording import save_recording
from lagsplat.job import Job

with Job(snakemake) as job:
    config = job.section(RecordingConfig)
    recording = read_recording(config)
    recording.split(config.train_fraction)  # too short a recording stops here, before training
    save_recording(job.output.recording, recording)
