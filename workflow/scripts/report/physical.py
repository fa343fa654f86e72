"""Gather the free rollouts of every system in one table."""

from lagsplat.io.files.atomic import load_json, write_text
from lagsplat.planning.job import Job
from lagsplat.report.common.table_rows import build_rows
from lagsplat.report.tables.learned_physics import build_physical_table, format_physical_latex

with Job(snakemake) as job:
    rows = build_rows(job.params.runs, [load_json(path) for path in job.input.metrics])
    write_text(job.output.csv, build_physical_table(rows).to_csv(index=False))
    write_text(job.output.tex, format_physical_latex(rows, titles=job.params.titles))
