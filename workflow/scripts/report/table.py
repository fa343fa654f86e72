"""Gather the scores of every run and of every baseline in one table."""

from lagsplat.io.files.atomic import load_json
from lagsplat.planning.job import Job
from lagsplat.report.common.printed_table import write_tables
from lagsplat.report.tables.benchmark import build_benchmark_rows, build_benchmark_table, lay_out_benchmark

with Job(snakemake) as job:
    ours, theirs = ([load_json(path) for path in paths] for paths in (job.input.metrics, job.input.baselines))
    simple = [load_json(path)["predictors"] for path in [*job.input.simple, *job.input.odes]]
    image_models = [*job.params.image_models, *job.params.odes]
    rows = build_benchmark_rows(job.params.runs, ours, image_models, simple, job.params.baselines, theirs)
    table = build_benchmark_table(rows)
    write_tables(job.output, table, lay_out_benchmark(table, titles=job.params.titles))
