"""Compare the settings of the paper and of its published code with the chosen ones in one table."""

from lagsplat.io.files.atomic import load_json
from lagsplat.planning.job import Job
from lagsplat.report.common.printed_table import write_tables
from lagsplat.report.common.table_rows import build_rows
from lagsplat.report.tables.learned_physics import build_recipes_table, lay_out_recipes

with Job(snakemake) as job:
    rows = build_rows(job.params.runs, [load_json(path) for path in job.input.metrics])
    table = build_recipes_table(rows)
    write_tables(job.output, table, lay_out_recipes(table, titles=job.params.titles))
