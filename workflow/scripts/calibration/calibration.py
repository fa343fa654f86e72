"""Fit the choice model to all measured recordings."""

from pathlib import Path

from lagsplat.planning.job import Job

with Job(snakemake) as job:
    job.command("benchmarks.calibration.fit", *job.input.measures, "--out", Path(job.output.model).parent)
