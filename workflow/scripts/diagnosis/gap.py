"""Gather the diagnoses of every system in one table."""

from lagsplat.io.files.atomic import load_json, write_text
from lagsplat.planning.job import Job
from lagsplat.report.tables.gap import build_gap_rows, build_gap_table, format_gap_latex

with Job(snakemake) as job:
    rows = build_gap_rows(job.params.runs, [load_json(path) for path in job.input.diagnoses])
    write_text(job.output.csv, build_gap_table(rows).to_csv(index=False))
    write_text(job.output.tex, format_gap_latex(rows, titles=job.params.titles))
