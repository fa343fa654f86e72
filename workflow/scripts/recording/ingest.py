"""Read and check a film or a published archive."""

from lagsplat.io.config import RecordingConfig
from lagsplat.io.read import read_recording
from lagsplat.io.recording.recording import save_recording
from lagsplat.io.recording.segments import split_train_held_out
from lagsplat.planning.job import Job

with Job(snakemake) as job:
    config = job.section(RecordingConfig)
    save_recording(job.output.recording, split_train_held_out(read_recording(config), config.split))
