"""Gather the scores of every run in one table."""

from lagsplat.evaluate.aggregate import aggregate
from lagsplat.io.plain import load_json
from lagsplat.job import Job

with Job(snakemake) as job:
    aggregate([load_json(path) for path in job.input.metrics])
