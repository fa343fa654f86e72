"""Gather the scores of every run and of every baseline in one table."""

from lagsplat.io.files.atomic import load_json
from lagsplat.planning.job import Job
from lagsplat.report.common.printed_table import write_tables
from lagsplat.report.common.table_rows import build_simple_rows
from lagsplat.report.tables.benchmark import build_benchmark_rows, build_benchmark_table, lay_out_benchmark

with Job(snakemake) as job:
    ours, theirs = ([load_json(path) for path in paths] for paths in (job.input.metrics, job.input.baselines))
    simple = [load_json(path)["predictors"] for path in [*job.input.simple, *job.input.odes]]
    simple_rows = build_simple_rows([*job.params.image_models, *job.params.odes], simple)
    rows = build_benchmark_rows(job.params.runs, ours, job.params.baselines, theirs, simple_rows)
    table = build_benchmark_table(rows)
    write_tables(job.output, table, lay_out_benchmark(table, titles=job.params.titles))
