"""Draw the latent trajectory of a chart."""

from lagsplat.chart.chart import load_chart
from lagsplat.planning.job import Job
from lagsplat.report.common.style import save_figures
from lagsplat.report.figures.training_curves import draw_latents

with Job(snakemake) as job:
    chart, _ = load_chart(job.input.chart)
    save_figures(job.output, draw_latents(chart, title=job.title("Latent trajectory")))
