"""Compare two decoders at an equal number of primitives."""

from lagsplat.evaluate.velocity_field import load_maps
from lagsplat.io.files.atomic import write_text
from lagsplat.planning.job import Job
from lagsplat.report.tables.deformation import build_deformation_table, format_deformation_latex

with Job(snakemake) as job:
    table = build_deformation_table(job.params.runs, [load_maps(path)[1] for path in job.input.maps])
    write_text(job.output.csv, table.to_csv(index=False))
    write_text(job.output.tex, format_deformation_latex(table, titles=job.params.titles))
