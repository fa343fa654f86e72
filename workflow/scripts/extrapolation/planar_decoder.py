"""Fit one of two decoders to the training frames at their frozen latents."""

from dataclasses import replace

from lagsplat.chart.chart import load_chart
from lagsplat.io.recording.recording import load_recording
from lagsplat.planning.job import Job
from lagsplat.stage1.config import PlanarDecoderConfig, Stage1Config
from lagsplat.stage1.planar_decoder import fit_planar_decoder, save_planar_decoder

with Job(snakemake) as job:
    chart, _ = load_chart(job.input.chart)
    train, _ = load_recording(job.input.recording).split()
    config, stage1 = job.section(PlanarDecoderConfig), job.section(Stage1Config, "stage1")
    latents = chart.to_raw(chart.latents[: chart.n_train])
    schedule = replace(stage1, batch=config.batch)
    decoder, story = fit_planar_decoder(
        job.wildcards.planar_decoder, train.frames, latents, config, schedule, seed=job.seed
    )
    save_planar_decoder(job.output.model, decoder, {**job.header, **story._asdict(), "steps": config.steps})
