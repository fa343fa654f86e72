"""Read and check a film or a published archive."""

from lagsplat.io.config import RecordingConfig
from lagsplat.io.read import read_recording
from lagsplat.io.recording import save_recording
from lagsplat.io.split import divide
from lagsplat.job import Job

with Job(snakemake) as job:
    config = job.section(RecordingConfig)
    save_recording(job.output.recording, divide(read_recording(config), config.split))
