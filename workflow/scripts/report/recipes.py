"""Compare the settings of the paper and of its published code with the chosen ones in one table."""

from lagsplat.io.files.atomic import load_json, write_text
from lagsplat.planning.job import Job
from lagsplat.report.common.table_rows import build_rows, build_table
from lagsplat.report.tables.learned_physics import RECIPE_COLUMNS, format_recipes_latex

with Job(snakemake) as job:
    rows = build_rows(job.params.runs, [load_json(path) for path in job.input.metrics])
    write_text(job.output.csv, build_table(rows, RECIPE_COLUMNS).to_csv(index=False))
    write_text(job.output.tex, format_recipes_latex(rows, titles=job.params.titles))
