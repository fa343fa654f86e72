"""Gather the scores of every run and of every baseline in one table."""

from lagsplat.io.files.atomic import load_json, write_text
from lagsplat.planning.job import Job
from lagsplat.report.tables.benchmark import (
    build_benchmark_rows,
    build_benchmark_table,
    format_benchmark_latex,
)

with Job(snakemake) as job:
    ours, theirs = ([load_json(path) for path in paths] for paths in (job.input.metrics, job.input.baselines))
    rows = build_benchmark_rows(job.params.runs, ours, job.params.baselines, theirs)
    write_text(job.output.csv, build_benchmark_table(rows).to_csv(index=False))
    write_text(job.output.tex, format_benchmark_latex(rows, titles=job.params.titles))
