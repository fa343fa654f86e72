"""Fit a finer decoder over the frozen chart."""

from pathlib import Path

from lagsplat.chart.chart import load_chart
from lagsplat.io.files.atomic import save_csv
from lagsplat.io.recording.recording import load_recording
from lagsplat.planning.job import Job
from lagsplat.stage1.autoencoder import save_autoencoder
from lagsplat.stage1.config import RenderConfig, Stage1Config
from lagsplat.stage1.fit import fit_decoder

with Job(snakemake) as job:
    train, _ = load_recording(job.input.fine).split()
    chart, _ = load_chart(job.input.chart)
    latents = chart.to_raw(chart.train.smoothed(chart.smoothing_frames).latents)
    render, checkpoint = job.section(RenderConfig, "render"), Path(job.params.checkpoint)
    decoder, curve = fit_decoder(
        train.frames,
        latents,
        job.section(Stage1Config),
        render,
        seed=job.seed,
        checkpoint=checkpoint,
        identity=job.identity,
    )
    save_autoencoder(job.output.decoder, decoder, job.header)
    save_csv(job.output.curve, [point._asdict() for point in curve])
    checkpoint.unlink(missing_ok=True)
