"""Fit the Lagrangian to the training part of a chart."""

from dataclasses import asdict
from pathlib import Path

from lagsplat.chart.chart import load_chart
from lagsplat.io.files.atomic import save_csv
from lagsplat.planning.job import Job
from lagsplat.stage1.autoencoder import load_autoencoder
from lagsplat.stage2.config import Stage2Config
from lagsplat.stage2.decoder_mass import compute_decoder_geometry
from lagsplat.stage2.finished_fits import FinishedFits
from lagsplat.stage2.fit import fit_dynamics, save_dynamics

with Job(snakemake) as job:
    autoencoder, _ = load_autoencoder(job.input.autoencoder)
    chart, _ = load_chart(job.input.chart)
    checkpoint = Path(job.params.checkpoint)
    train, geometry = (
        chart.train.smoothed(chart.smoothing_frames),
        compute_decoder_geometry(autoencoder, chart),
    )
    lagrangian, report = fit_dynamics(
        train,
        chart.metric,
        job.section(Stage2Config),
        job.seed,
        rest=chart.rest,
        geometry=geometry,
        measured=chart.train,
        on_candidate=job.say,
        recall=FinishedFits(checkpoint, identity=job.identity),
    )
    for warning in report.warnings:
        job.say(warning)
    save_dynamics(job.output.dynamics, lagrangian, job.header, report)
    save_csv(job.output.curve, [asdict(row) for row in report.curve])
    checkpoint.unlink(missing_ok=True)
