"""Compare what was learned of every simulated system with its truth."""

from lagsplat.io.atomic import write_text
from lagsplat.io.plain import load_json
from lagsplat.job import Job
from lagsplat.report.against_truth import latex_truth, truth_table

with Job(snakemake) as job:
    table = truth_table(job.params.runs, [load_json(path) for path in job.input.metrics])
    write_text(job.output.csv, table.to_csv(index=False))
    write_text(job.output.tex, latex_truth(table, titles=job.params.titles))
