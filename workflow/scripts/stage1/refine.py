"""Make a recording once more with finer frames: the same film or the same motion at a higher resolution."""

from dataclasses import replace

from lagsplat.io.config import RecordingConfig
from lagsplat.io.read import read_recording
from lagsplat.io.recording.recording import load_recording, save_recording
from lagsplat.planning.job import Job
from lagsplat.stage1.config import RenderConfig
from lagsplat.systems.config import ReleaseConfig, SimulationConfig
from lagsplat.systems.simulate import resize_simulation, simulate_system

with Job(snakemake) as job:
    recording, config = load_recording(job.input.recording), job.section(RecordingConfig)
    height, width = job.section(RenderConfig, "render").fine_size(recording.height, recording.width)
    if config.kind == "simulated":
        driven, released = job.choice(SimulationConfig, "simulation"), job.choice(ReleaseConfig, "release")
        fine, _ = simulate_system(
            *resize_simulation(driven, released, height=height, width=width), seed=job.seed
        )
    else:
        fine = read_recording(replace(config, height=height, width=width))
    save_recording(job.output.fine, replace(fine, n_train=recording.n_train))
