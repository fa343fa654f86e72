"""Measure the frames that the authors' own tool predicted."""

from lagsplat.chart.chart import load_chart
from lagsplat.evaluate.extrapolate_pictures import extrapolate_frames
from lagsplat.evaluate.extrapolation_config import ExtrapolationConfig
from lagsplat.io.artefact import load_artefact
from lagsplat.io.plain import save_json
from lagsplat.io.recording import load_recording
from lagsplat.job import Job
from lagsplat.stage1.autoencoder import load_autoencoder
from lagsplat.stage2.fit import load_dynamics

with Job(snakemake) as job:
    run = (
        load_autoencoder(job.input.autoencoder)[0],
        load_chart(job.input.chart)[0],
        load_dynamics(job.input.dynamics)[0],
    )
    frames = load_artefact(job.input.frames, kind="predicted", schema=1, mapped=("frames",))[0]["frames"]
    recording, config = load_recording(job.input.recording), job.section(ExtrapolationConfig)
    found = extrapolate_frames(*run, frames, recording, config)
    save_json(job.output.found, found | {"made_by": job.header})
