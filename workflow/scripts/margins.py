"""Compare every variant of the dynamics with the constant-coefficient one."""

from lagsplat.io.atomic import write_text
from lagsplat.io.plain import load_json
from lagsplat.job import Job
from lagsplat.report.margins import margin_table

with Job(snakemake) as job:
    table = margin_table(job.params.runs, [load_json(path) for path in job.input.metrics])
    write_text(job.output.csv, table.to_csv(index=False))
