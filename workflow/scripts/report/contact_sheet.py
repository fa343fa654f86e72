"""Show every figure on one sheet."""

from PIL import Image

from lagsplat.planning.job import Job
from lagsplat.report.common.style import save_figures
from lagsplat.report.figures.contact_sheet import draw_contact_sheet

with Job(snakemake) as job:
    pictures = [(path.removeprefix("results/"), Image.open(path)) for path in job.input.pictures]
    save_figures(job.output, draw_contact_sheet(pictures, title=job.params.title))
