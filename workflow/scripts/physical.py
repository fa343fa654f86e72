"""Gather the free rollouts of every system in one table."""

from lagsplat.io.files.atomic import write_text
from lagsplat.io.files.json_files import load_json
from lagsplat.planning.job import Job
from lagsplat.report.common.aggregate import rows_of
from lagsplat.report.tables.learned_physics import latex_physical, physical_table

with Job(snakemake) as job:
    rows = rows_of(job.params.runs, [load_json(path) for path in job.input.metrics])
    write_text(job.output.csv, physical_table(rows).to_csv(index=False))
    write_text(job.output.tex, latex_physical(rows, titles=job.params.titles))
