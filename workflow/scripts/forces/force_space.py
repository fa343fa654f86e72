"""Push a fitted run in space, and draw it from three sides."""

from lagsplat.chart.chart import load_chart
from lagsplat.evaluate.forces.motion import push_in_space
from lagsplat.forces.config import ForcesConfig
from lagsplat.forces.operating_point import hold_at_load
from lagsplat.io.files.atomic import save_json
from lagsplat.matter.field import load_matter
from lagsplat.planning.job import Job
from lagsplat.report.common.style import save_figures
from lagsplat.report.figures.forces import draw_space_push
from lagsplat.stage1.autoencoder import load_autoencoder
from lagsplat.stage2.fit import load_dynamics

with Job(snakemake) as job:
    loads = (load_autoencoder, load_chart, load_dynamics, load_matter)
    point = hold_at_load(*(load(path)[0] for load, path in zip(loads, job.input.run, strict=True)))
    push = push_in_space(point, job.section(ForcesConfig))
    save_json(job.output.metrics, push.numbers() | {"made_by": job.header})
    figure = draw_space_push(point, push, title=job.params.title)
    save_figures((job.output.pdf, job.output.png), figure)
