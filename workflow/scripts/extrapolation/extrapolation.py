"""Compare the models past their training frames in one table."""

from lagsplat.io.files.atomic import load_json, write_text
from lagsplat.planning.job import Job
from lagsplat.report.tables.extrapolation import (
    build_extrapolation_table,
    format_extrapolation_latex,
    group_models,
)

with Job(snakemake) as job:
    kinds = {"forecaster": job.input.forecasters, "ode": job.input.odes, "authors": job.input.authors}
    found = [load_json(path) for path in [*job.input.runs, *(path for own in kinds.values() for path in own)]]
    others = sorted(job.params.others, key=lambda run: list(kinds).index(run["kind"]))
    table = build_extrapolation_table(group_models(job.params.runs, others, found))
    write_text(job.output.csv, table.to_csv(index=False))
    write_text(job.output.tex, format_extrapolation_latex(table, titles=job.params.titles))
