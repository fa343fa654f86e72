"""Gather the scores of every run and of every baseline in one table."""

from lagsplat.io.atomic import write_text
from lagsplat.io.plain import load_json
from lagsplat.job import Job
from lagsplat.report.baseline_rows import with_baselines
from lagsplat.report.tables import benchmark_table, latex_table

with Job(snakemake) as job:
    ours, theirs = ([load_json(path) for path in paths] for paths in (job.input.metrics, job.input.baselines))
    rows = with_baselines(job.params.runs, ours, job.params.baselines, theirs)
    write_text(job.output.csv, benchmark_table(rows).to_csv(index=False))
    write_text(job.output.tex, latex_table(rows, titles=job.params.titles))
