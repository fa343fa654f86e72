"""Simulate a recording, and keep its truth apart from it."""

from lagsplat.io.config import SplitConfig
from lagsplat.io.recording.recording import save_recording
from lagsplat.io.recording.segments import divide
from lagsplat.planning.job import Job
from lagsplat.systems.config import ReleaseConfig, SimulationConfig
from lagsplat.systems.simulate import stand_in
from lagsplat.systems.truth import save_truth

with Job(snakemake) as job:
    driven, released = job.choice(SimulationConfig, "simulation"), job.choice(ReleaseConfig, "release")
    recording, truth = stand_in(driven, released, seed=job.seed)
    divided = divide(recording, job.section(SplitConfig, "split"))
    save_truth(job.output.truth, truth, job.header)
    save_recording(job.output.recording, divided)
