"""Fit one of two decoders to the training frames at their frozen latents."""

from dataclasses import replace

from lagsplat.chart.chart import load_chart
from lagsplat.io.recording.recording import load_recording
from lagsplat.planning.job import Job
from lagsplat.stage1.config import FieldConfig, Stage1Config
from lagsplat.stage1.deformation_decoder import fit_deformation_field, save_deformation_field

with Job(snakemake) as job:
    chart, _ = load_chart(job.input.chart)
    train, _ = load_recording(job.input.recording).split()
    config, stage1 = job.section(FieldConfig), job.section(Stage1Config, "stage1")
    latents = chart.to_raw(chart.latents[: chart.n_train])
    schedule = replace(stage1, batch=config.batch)
    field, story = fit_deformation_field(
        job.wildcards.field, train.frames, latents, config, schedule, seed=job.seed
    )
    save_deformation_field(job.output.model, field, {**job.header, **story._asdict(), "steps": config.steps})
