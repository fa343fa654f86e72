"""Gather the free rollouts of every system in one table."""

from lagsplat.io.files.atomic import load_json
from lagsplat.planning.job import Job
from lagsplat.report.common.printed_table import write_tables
from lagsplat.report.common.table_rows import build_rows, build_simple_rows
from lagsplat.report.tables.learned_physics import build_physical_table, lay_out_physical

with Job(snakemake) as job:
    rows = build_rows(job.params.runs, [load_json(path) for path in job.input.metrics])
    simple = [load_json(path)["predictors"] for path in job.input.simple]
    table = build_physical_table([*rows, *build_simple_rows(job.params.image_models, simple)])
    write_tables(job.output, table, lay_out_physical(table, titles=job.params.titles))
