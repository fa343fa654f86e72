"""Put the figure of the chosen run where figures are looked for."""

import shutil

from lagsplat.planning.job import Job

with Job(snakemake) as job:
    for source, target in zip(job.input, job.output, strict=False):
        shutil.copyfile(source, target)
