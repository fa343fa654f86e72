"""Measure a neural differential equation far past its training frames."""

from lagsplat.baselines.neural_ode import load_ode
from lagsplat.chart.chart import load_chart
from lagsplat.evaluate.config import ExtrapolationConfig
from lagsplat.evaluate.extrapolation.forecast import extrapolate_ode
from lagsplat.evaluate.extrapolation.scene import open_scene
from lagsplat.io.files.atomic import save_json
from lagsplat.io.recording.recording import load_recording
from lagsplat.planning.job import Job
from lagsplat.stage1.autoencoder import load_autoencoder
from lagsplat.stage2.fit import load_dynamics

with Job(snakemake) as job:
    run = (
        load_autoencoder(job.input.autoencoder)[0],
        load_chart(job.input.chart)[0],
        load_dynamics(job.input.dynamics)[0],
    )
    model, header = load_ode(job.input.model)
    recording, config = load_recording(job.input.recording), job.section(ExtrapolationConfig)
    found = extrapolate_ode(open_scene(*run, recording, config), model)
    save_json(job.output.found, found | {"training_wall_s": header["wall_s"], "made_by": job.header})
