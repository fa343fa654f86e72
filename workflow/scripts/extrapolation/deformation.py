"""Compare two decoders at an equal number of primitives."""

from lagsplat.evaluate.velocity_field import load_maps
from lagsplat.planning.job import Job
from lagsplat.report.common.printed_table import write_tables
from lagsplat.report.tables.deformation import build_deformation_table, lay_out_deformation

with Job(snakemake) as job:
    table = build_deformation_table(job.params.runs, [load_maps(path)[1] for path in job.input.maps])
    write_tables(job.output, table, lay_out_deformation(table, titles=job.params.titles))
