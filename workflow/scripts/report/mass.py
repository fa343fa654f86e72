"""Compare the forms of the mass over one frozen autoencoder in one table."""

from lagsplat.io.files.atomic import load_json, write_text
from lagsplat.planning.job import Job
from lagsplat.report.common.table_rows import build_table
from lagsplat.report.tables.learned_physics import MASS_COLUMNS, build_mass_rows, format_mass_latex

with Job(snakemake) as job:
    rows = build_mass_rows(job.params.runs, [load_json(path) for path in job.input.metrics])
    write_text(job.output.csv, build_table(rows, MASS_COLUMNS).to_csv(index=False))
    write_text(job.output.tex, format_mass_latex(rows, titles=job.params.titles))
