"""Gather the blind check of every tier in one table."""

from pathlib import Path

from lagsplat.planning.job import Job

with Job(snakemake) as job:
    pairs = zip(job.params.tiers, job.input.scores, strict=True)
    folders = [f"{tier}={Path(path).parent}" for tier, path in pairs]
    job.command("benchmarks.gapgen.tiers", "--out", Path(job.output.tex).with_suffix(""), *folders)
