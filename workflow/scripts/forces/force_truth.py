"""Compare the answers to known forces with the true ones, system by system."""

from lagsplat.io.files.atomic import load_json, write_text
from lagsplat.planning.job import Job
from lagsplat.report.common.table_rows import build_table
from lagsplat.report.tables.forces import ACCURACY_COLUMNS, build_force_rows, format_force_latex

with Job(snakemake) as job:
    rows = build_force_rows(job.params.runs, [load_json(path) for path in job.input.metrics])
    write_text(job.output.csv, build_table(rows, ACCURACY_COLUMNS).to_csv(index=False))
    write_text(job.output.tex, format_force_latex(rows, titles=job.params.titles))
