"""Push a fitted run in the picture and draw where it comes to rest."""

from lagsplat.chart.chart import load_chart
from lagsplat.forces.config import ForcesConfig
from lagsplat.forces.operating_point import hold_at_load
from lagsplat.matter.field import load_matter
from lagsplat.planning.job import Job
from lagsplat.report.common.style import save_figures
from lagsplat.report.figures.forces import compute_force_panels, draw_forces
from lagsplat.stage1.autoencoder import load_autoencoder
from lagsplat.stage2.fit import load_dynamics, load_parameter_draws

with Job(snakemake) as job:
    loads = (load_autoencoder, load_chart, load_dynamics, load_matter)
    point = hold_at_load(*(load(path)[0] for load, path in zip(loads, job.input.run, strict=True)))
    panels = compute_force_panels(
        point,
        job.section(ForcesConfig),
        hanging=job.params.hanging,
        draws=load_parameter_draws(job.input.run[2]),
    )
    save_figures(job.output, draw_forces(panels, title=job.params.title))
