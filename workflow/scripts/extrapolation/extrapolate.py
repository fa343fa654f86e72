"""Measure a trained run far past its training frames."""

from lagsplat.chart.chart import load_chart
from lagsplat.evaluate.config import ExtrapolationConfig
from lagsplat.evaluate.extrapolation.forecast import extrapolate_run
from lagsplat.evaluate.extrapolation.scene import open_scene
from lagsplat.io.files.atomic import save_json
from lagsplat.io.recording.recording import load_recording
from lagsplat.planning.job import Job
from lagsplat.stage1.autoencoder import load_autoencoder
from lagsplat.stage2.fit import load_dynamics

with Job(snakemake) as job:
    autoencoder, _ = load_autoencoder(job.input.autoencoder)
    chart, _ = load_chart(job.input.chart)
    lagrangian, _ = load_dynamics(job.input.dynamics)
    recording = load_recording(job.input.recording)
    scene = open_scene(autoencoder, chart, lagrangian, recording, job.section(ExtrapolationConfig))
    save_json(job.output.found, extrapolate_run(scene) | {"made_by": job.header})
