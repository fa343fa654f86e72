"""Simulate a recording, and keep its truth apart from it."""

from lagsplat.io.config import SplitConfig
from lagsplat.io.recording import save_recording
from lagsplat.io.split import divide
from lagsplat.job import Job
from lagsplat.systems.config import SimulationConfig
from lagsplat.systems.simulate import simulate
from lagsplat.systems.truth import save_truth

with Job(snakemake) as job:
    recording, truth = simulate(job.section(SimulationConfig), seed=job.seed)
    divided = divide(recording, job.section(SplitConfig, "split"))
    save_truth(job.output.truth, truth, job.header)
    save_recording(job.output.recording, divided)
