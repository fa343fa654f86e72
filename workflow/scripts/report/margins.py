"""Compare every variant of the dynamics with the constant-coefficient one."""

from lagsplat.io.files.atomic import load_json
from lagsplat.planning.job import Job
from lagsplat.report.common.printed_table import write_tables
from lagsplat.report.tables.benchmark import build_margin_table, lay_out_margins

with Job(snakemake) as job:
    table = build_margin_table(job.params.runs, [load_json(path) for path in job.input.metrics])
    write_tables(job.output, table, lay_out_margins(table, titles=job.params.titles))
