"""Draw the latent trajectory of a chart."""

from lagsplat.chart.chart import load_chart
from lagsplat.planning.job import Job
from lagsplat.report.figures.index import draw_latents, save_figure

with Job(snakemake) as job:
    chart, _ = load_chart(job.input.chart)
    save_figure(job.output.figure, draw_latents(chart, title=job.title("Latent trajectory")))
