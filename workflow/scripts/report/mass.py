"""Compare the forms of the mass over one frozen autoencoder in one table."""

from lagsplat.io.files.atomic import load_json
from lagsplat.planning.job import Job
from lagsplat.report.common.printed_table import write_tables
from lagsplat.report.tables.learned_physics import build_mass_rows, build_mass_table, lay_out_mass

with Job(snakemake) as job:
    rows = build_mass_rows(job.params.runs, [load_json(path) for path in job.input.metrics])
    table = build_mass_table(rows)
    write_tables(job.output, table, lay_out_mass(table, titles=job.params.titles))
