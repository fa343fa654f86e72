"""Compare the models past their training frames in one table."""

from lagsplat.io.files.atomic import load_json
from lagsplat.planning.job import Job
from lagsplat.report.common.printed_table import write_tables
from lagsplat.report.tables.extrapolation import (
    build_extrapolation_table,
    group_models,
    lay_out_extrapolation,
)

with Job(snakemake) as job:
    kinds = {
        "trivial": job.input.trivial,
        "forecaster": job.input.forecasters,
        "ode": job.input.odes,
        "authors": job.input.authors,
    }
    found = [load_json(path) for path in [*job.input.runs, *(path for own in kinds.values() for path in own)]]
    others = sorted(job.params.others, key=lambda run: list(kinds).index(run["kind"]))
    table = build_extrapolation_table(group_models(job.params.runs, others, found))
    write_tables(job.output, table, lay_out_extrapolation(table, titles=job.params.titles))
