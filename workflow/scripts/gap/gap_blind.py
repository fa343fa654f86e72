"""Gather the blind check of every tier in one table."""

from pathlib import Path

import pandas as pd

from lagsplat.planning.job import Job
from lagsplat.report.common.printed_table import write_tables
from lagsplat.report.tables.gap import lay_out_blind

with Job(snakemake) as job:
    pairs = zip(job.params.tiers, job.input.scores, strict=True)
    folders = [f"{tier}={Path(path).parent}" for tier, path in pairs]
    job.command("benchmarks.gapgen.tiers", "--out", job.output.csv, *folders)
    table = pd.read_csv(job.output.csv)
    write_tables(job.output, table, lay_out_blind(table))
