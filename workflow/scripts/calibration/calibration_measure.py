"""Measure the alternatives of a verdict on a batch of recordings."""

import json

from lagsplat.planning.job import Job

with Job(snakemake) as job:
    files = ("--split", job.input.data, "--out", job.output.measures)
    job.command("benchmarks.calibration.measure", *files, "--settings", json.dumps(job.params.cfg))
