"""Gather the free rollouts of every system in one table."""

from lagsplat.io.atomic import write_text
from lagsplat.io.plain import load_json
from lagsplat.job import Job
from lagsplat.report.physical import latex_physical, physical_table
from lagsplat.report.rows import rows_of

with Job(snakemake) as job:
    rows = rows_of(job.params.runs, [load_json(path) for path in job.input.metrics])
    write_text(job.output.csv, physical_table(rows).to_csv(index=False))
    write_text(job.output.tex, latex_physical(rows, titles=job.params.titles))
