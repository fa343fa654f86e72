"""Compare what was learned of every simulated system with its truth."""

from lagsplat.io.files.atomic import load_json
from lagsplat.planning.job import Job
from lagsplat.report.common.printed_table import write_tables
from lagsplat.report.tables.learned_physics import build_truth_table, lay_out_truth

with Job(snakemake) as job:
    table = build_truth_table(job.params.runs, [load_json(path) for path in job.input.metrics])
    write_tables(job.output, table, lay_out_truth(table, titles=job.params.titles))
