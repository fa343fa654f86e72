"""Film a simulated arm once more, with an effect that is withheld from the sim."""

from dataclasses import replace

from lagsplat.io.recording.recording import save_recording
from lagsplat.planning.job import Job
from lagsplat.systems.config import PlantedEffectConfig, SimulationConfig
from lagsplat.systems.simulate import simulate_planted

with Job(snakemake) as job:
    config = replace(job.section(SimulationConfig, "simulation"), n_frames=job.params.n_frames)
    planted = job.section(PlantedEffectConfig, "planted")
    recording = simulate_planted(config, planted, seed=job.params.drive, scene=job.seed)
    save_recording(job.output.recording, recording)
