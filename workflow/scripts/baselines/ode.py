"""Fit a neural differential equation to the training part of a chart."""

from pathlib import Path

from lagsplat.baselines.config import OdeConfig
from lagsplat.baselines.neural_ode import save_ode
from lagsplat.baselines.neural_ode_fit import fit_ode
from lagsplat.chart.chart import load_chart
from lagsplat.io.files.atomic import save_csv
from lagsplat.planning.job import Job

with Job(snakemake) as job:
    chart, _ = load_chart(job.input.chart)
    checkpoint = Path(job.params.checkpoint)
    ode, curve = fit_ode(
        chart.train.smoothed(chart.smoothing_frames),
        chart.metric,
        job.section(OdeConfig),
        seed=job.seed,
        checkpoint=checkpoint,
        identity=job.identity,
    )
    save_ode(job.output.model, ode, {**job.header, "wall_s": curve[-1].seconds})
    save_csv(job.output.curve, [point._asdict() for point in curve])
    checkpoint.unlink(missing_ok=True)
