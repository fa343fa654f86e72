"""Gather the scores of every run in one table."""

from lagsplat.io.atomic import write_text
from lagsplat.io.plain import load_json
from lagsplat.job import Job
from lagsplat.report.rows import rows_of
from lagsplat.report.tables import benchmark_table, latex_table

with Job(snakemake) as job:
    rows = rows_of(job.params.runs, [load_json(path) for path in job.input.metrics])
    write_text(job.output.csv, benchmark_table(rows).to_csv(index=False))
    write_text(job.output.tex, latex_table(rows, titles=job.params.titles))
