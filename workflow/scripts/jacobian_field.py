"""Draw the velocities of the primitives of two decoders on one colour scale."""

from lagsplat.evaluate.velocity_maps import load_maps
from lagsplat.job import Job
from lagsplat.report.deformation import draw_jacobian_field
from lagsplat.report.figures import save_figure

with Job(snakemake) as job:
    maps, measures = load_maps(job.input.maps[0])
    for path in (job.output.pdf, job.output.png):
        save_figure(path, draw_jacobian_field(maps, measures, title=job.params.title))
