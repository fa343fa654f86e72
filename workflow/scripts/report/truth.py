"""Compare what was learned of every simulated system with its truth."""

from lagsplat.io.files.atomic import load_json, write_text
from lagsplat.planning.job import Job
from lagsplat.report.tables.learned_physics import build_truth_table, format_truth_latex

with Job(snakemake) as job:
    table = build_truth_table(job.params.runs, [load_json(path) for path in job.input.metrics])
    write_text(job.output.csv, table.to_csv(index=False))
    write_text(job.output.tex, format_truth_latex(table, titles=job.params.titles))
