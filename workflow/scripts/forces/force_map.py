"""Draw where on the object forces are answered wrongly."""

from lagsplat.chart.chart import load_chart
from lagsplat.forces.operating_point import hold_at_load
from lagsplat.io.files.atomic import load_json
from lagsplat.matter.field import load_matter
from lagsplat.planning.job import Job
from lagsplat.report.common.style import save_figures
from lagsplat.report.figures.forces import draw_force_map
from lagsplat.stage1.autoencoder import load_autoencoder
from lagsplat.stage2.fit import load_dynamics

with Job(snakemake) as job:
    loads = (load_autoencoder, load_chart, load_dynamics, load_matter)
    point = hold_at_load(*(load(path)[0] for load, path in zip(loads, job.input.run, strict=True)))
    unknown = {"refused": "true answers are known of simulated recordings alone"}
    truth = load_json(job.input.metrics)["truth"] or unknown
    picture = point.render_images(point.rest[None])[0]
    save_figures(job.output, draw_force_map(picture, truth, title=job.params.title))
