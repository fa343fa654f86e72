"""Gather what holds of forces whatever the energy scale is."""

from lagsplat.io.files.atomic import load_json, write_text
from lagsplat.planning.job import Job
from lagsplat.report.common.table_rows import build_table
from lagsplat.report.tables.forces import INVARIANT_COLUMNS, build_invariant_rows, format_invariant_latex

with Job(snakemake) as job:
    solid = zip(job.params.solid, [load_json(path) for path in job.input.solid], strict=True)
    metrics = [load_json(path) for path in job.input.metrics]
    rows = build_invariant_rows(job.params.runs, metrics, solid=list(solid))
    write_text(job.output.csv, build_table(rows, INVARIANT_COLUMNS).to_csv(index=False))
    write_text(job.output.tex, format_invariant_latex(rows, titles=job.params.titles))
