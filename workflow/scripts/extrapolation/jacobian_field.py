"""Draw the velocities of the primitives of two decoders on one colour scale."""

from lagsplat.evaluate.velocity_field import load_maps
from lagsplat.planning.job import Job
from lagsplat.report.common.style import save_figures
from lagsplat.report.tables.deformation import draw_jacobian_field

with Job(snakemake) as job:
    maps, measures = load_maps(job.input.maps[0])
    figure = draw_jacobian_field(maps, measures, title=job.params.title)
    save_figures((job.output.pdf, job.output.png), figure)
