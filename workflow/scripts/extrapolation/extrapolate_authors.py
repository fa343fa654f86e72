"""Measure the frames that the authors' own tool predicted."""

from lagsplat.chart.chart import load_chart
from lagsplat.evaluate.config import ExtrapolationConfig
from lagsplat.evaluate.extrapolation.images import extrapolate_frames
from lagsplat.evaluate.extrapolation.scene import open_scene
from lagsplat.io.files.artifact import load_artifact
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
    frames = load_artifact(job.input.frames, kind="predicted", schema=1, mapped=("frames",))[0]["frames"]
    recording, config = load_recording(job.input.recording), job.section(ExtrapolationConfig)
    found = extrapolate_frames(open_scene(*run, recording, config), frames)
    save_json(job.output.found, found | {"made_by": job.header})
