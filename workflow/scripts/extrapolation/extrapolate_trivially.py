"""Measure laws that any other must beat far past the training frames of a run."""

from lagsplat.chart.chart import load_chart
from lagsplat.evaluate.config import ExtrapolationConfig
from lagsplat.evaluate.extrapolation.forecast import extrapolate_trivially
from lagsplat.evaluate.extrapolation.scene import open_scene
from lagsplat.io.files.atomic import save_json
from lagsplat.io.recording.recording import load_recording
from lagsplat.planning.job import Job
from lagsplat.planning.plan import TRIVIAL
from lagsplat.stage1.autoencoder import load_autoencoder
from lagsplat.stage2.fit import load_dynamics

with Job(snakemake) as job:
    run = (
        load_autoencoder(job.input.autoencoder)[0],
        load_chart(job.input.chart)[0],
        load_dynamics(job.input.dynamics)[0],
    )
    recording, config = load_recording(job.input.recording), job.section(ExtrapolationConfig)
    found = extrapolate_trivially(open_scene(*run, recording, config))
    for name, path in zip(TRIVIAL, job.output.found, strict=True):
        save_json(path, found[name] | {"training_wall_s": 0.0, "made_by": job.header})
