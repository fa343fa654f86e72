"""Simulate a recording, and keep its truth apart from it."""

from lagsplat.io.recording import save_recording
from lagsplat.job import Job
from lagsplat.systems.config import SimulationConfig
from lagsplat.systems.simulate import simulate
from lagsplat.systems.truth import save_truth

with Job(snakemake) as job:
    recording, truth = simulate(job.section(SimulationConfig), seed=job.seed)
    recording.split(job.params.train_fraction)  # too short a recording stops here, before training
    save_truth(job.output.truth, truth, job.header)
    save_recording(job.output.recording, recording)
