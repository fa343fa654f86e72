"""Whiten the latents of a recording and measure what of them can be seen."""

from lagsplat.chart.chart import fit_chart, require_trained_autoencoder, save_chart
from lagsplat.chart.config import ChartConfig
from lagsplat.io.recording.recording import load_recording
from lagsplat.planning.job import Job
from lagsplat.stage1.autoencoder import load_autoencoder

with Job(snakemake) as job:
    recording = load_recording(job.input.recording)
    autoencoder, _ = load_autoencoder(job.input.autoencoder)
    require_trained_autoencoder(autoencoder, recording.split()[0].frames)
    chart = fit_chart(autoencoder, recording, job.section(ChartConfig), seed=job.seed)
    job.say(f"condition {chart.condition:.0f}; dimension {chart.intrinsic_dimension:.2f}, chosen {chart.d}")
    save_chart(job.output.chart, chart, job.header)
