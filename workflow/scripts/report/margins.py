"""Compare every variant of the dynamics with the constant-coefficient one."""

from lagsplat.io.files.atomic import load_json, write_text
from lagsplat.planning.job import Job
from lagsplat.report.tables.benchmark import build_margin_table

with Job(snakemake) as job:
    table = build_margin_table(job.params.runs, [load_json(path) for path in job.input.metrics])
    write_text(job.output.csv, table.to_csv(index=False))
