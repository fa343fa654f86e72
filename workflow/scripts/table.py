"""Gather the scores of every run and of every baseline in one table."""

from lagsplat.io.files.atomic import write_text
from lagsplat.io.files.json_files import load_json
from lagsplat.planning.job import Job
from lagsplat.report.tables.benchmark import benchmark_table, latex_table, with_baselines

with Job(snakemake) as job:
    ours, theirs = ([load_json(path) for path in paths] for paths in (job.input.metrics, job.input.baselines))
    rows = with_baselines(job.params.runs, ours, job.params.baselines, theirs)
    write_text(job.output.csv, benchmark_table(rows).to_csv(index=False))
    write_text(job.output.tex, latex_table(rows, titles=job.params.titles))
