"""Put the figure of the chosen run where figures are looked for."""

from lagsplat.io.files.atomic import copy_file
from lagsplat.planning.job import Job

with Job(snakemake) as job:
    for source, target in zip(job.input, job.output, strict=False):
        copy_file(source, target)
