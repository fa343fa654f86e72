"""Compare the answers to known forces with the true ones, system by system."""

from lagsplat.io.files.atomic import load_json
from lagsplat.planning.job import Job
from lagsplat.report.common.printed_table import write_tables
from lagsplat.report.common.table_rows import build_table
from lagsplat.report.tables.forces import ACCURACY_COLUMNS, build_force_rows, lay_out_forces

with Job(snakemake) as job:
    rows = build_force_rows(job.params.runs, [load_json(path) for path in job.input.metrics])
    table = build_table(rows, ACCURACY_COLUMNS)
    write_tables(job.output, table, lay_out_forces(table, titles=job.params.titles))
