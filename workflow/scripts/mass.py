"""Compare the forms of the mass over one frozen autoencoder in one table."""

from lagsplat.io.files.atomic import write_text
from lagsplat.io.files.json_files import load_json
from lagsplat.planning.job import Job
from lagsplat.report.tables.learned_physics import latex_mass, mass_rows, mass_table

with Job(snakemake) as job:
    rows = mass_rows(job.params.runs, [load_json(path) for path in job.input.metrics])
    write_text(job.output.csv, mass_table(rows).to_csv(index=False))
    write_text(job.output.tex, latex_mass(rows, titles=job.params.titles))
