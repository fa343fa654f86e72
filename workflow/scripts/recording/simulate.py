"""Simulate a recording, and keep its truth apart from it."""

from lagsplat.io.config import SplitConfig
from lagsplat.io.recording.recording import save_recording
from lagsplat.io.recording.segments import split_train_held_out
from lagsplat.planning.job import Job
from lagsplat.systems.config import ReleaseConfig, SimulationConfig
from lagsplat.systems.simulate import simulate_system
from lagsplat.systems.truth import save_truth

with Job(snakemake) as job:
    driven, released = job.choice(SimulationConfig, "simulation"), job.choice(ReleaseConfig, "release")
    recording, truth = simulate_system(driven, released, seed=job.seed)
    divided = split_train_held_out(recording, job.section(SplitConfig, "split"))
    save_truth(job.output.truth, truth, job.header)
    save_recording(job.output.recording, divided)
