"""Gather what holds of forces whatever the energy scale is."""

from lagsplat.io.files.atomic import load_json
from lagsplat.planning.job import Job
from lagsplat.report.common.printed_table import write_tables
from lagsplat.report.common.table_rows import build_table
from lagsplat.report.tables.forces import INVARIANT_COLUMNS, build_invariant_rows, lay_out_invariants

with Job(snakemake) as job:
    solid = zip(job.params.solid, [load_json(path) for path in job.input.solid], strict=True)
    metrics = [load_json(path) for path in job.input.metrics]
    rows = build_invariant_rows(job.params.runs, metrics, solid=list(solid))
    table = build_table(rows, INVARIANT_COLUMNS)
    write_tables(job.output, table, lay_out_invariants(table, titles=job.params.titles))
