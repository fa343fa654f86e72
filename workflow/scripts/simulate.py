"""Simulate a recording, and keep its truth apart from it."""

from lagsplat.io.config import SplitConfig
from lagsplat.io.recording import save_recording
from lagsplat.io.split import divide
from lagsplat.job import Job
from lagsplat.systems.config import SimulationConfig
from lagsplat.systems.release_config import ReleaseConfig
from lagsplat.systems.stand_in import stand_in
from lagsplat.systems.truth import save_truth

with Job(snakemake) as job:
    driven, released = job.choice(SimulationConfig, "simulation"), job.choice(ReleaseConfig, "release")
    recording, truth = stand_in(driven, released, seed=job.seed)
    divided = divide(recording, job.section(SplitConfig, "split"))
    save_truth(job.output.truth, truth, job.header)
    save_recording(job.output.recording, divided)
