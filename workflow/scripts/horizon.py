"""Draw the image error of every model along the same long rollouts."""

from lagsplat.io.files.json_files import load_json
from lagsplat.planning.job import Job
from lagsplat.report.figures.index import draw_horizon, save_figure

with Job(snakemake) as job:
    found = [load_json(path)["horizon"] for path in [*job.input.metrics, *job.input.baselines]]
    models = list(zip(job.params.names, found, strict=True))
    for path in job.output:
        save_figure(path, draw_horizon(models, title=job.params.title))
