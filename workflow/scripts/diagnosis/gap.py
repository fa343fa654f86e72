"""Gather the diagnoses of every system in one table."""

from lagsplat.io.files.atomic import load_json
from lagsplat.planning.job import Job
from lagsplat.report.common.printed_table import write_tables
from lagsplat.report.tables.gap import build_gap_rows, build_gap_table, lay_out_gap

with Job(snakemake) as job:
    rows = build_gap_rows(job.params.runs, [load_json(path) for path in job.input.diagnoses])
    table = build_gap_table(rows)
    write_tables(job.output, table, lay_out_gap(table, titles=job.params.titles))
