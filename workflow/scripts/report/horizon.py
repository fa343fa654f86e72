"""Draw the image error of every model along the same long rollouts."""

from lagsplat.io.files.atomic import load_json
from lagsplat.planning.job import Job
from lagsplat.report.common.style import save_figures
from lagsplat.report.figures.training_curves import draw_horizon

with Job(snakemake) as job:
    found = [load_json(path)["horizon"] for path in [*job.input.metrics, *job.input.baselines]]
    models = list(zip(job.params.names, found, strict=True))
    save_figures(job.output, draw_horizon(models, title=job.params.title))
