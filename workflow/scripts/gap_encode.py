"""Train an autoencoder on each nominal film of a batch, freeze it, and write what it sees in every film."""

from dataclasses import replace
from pathlib import Path

from lagsplat.chart.config import ChartConfig
from lagsplat.pipelines.batch import batch_of, each, encode, sign
from lagsplat.planning.job import Job
from lagsplat.stage1.config import Stage1Config

with Job(snakemake) as job:
    size, out = job.params.film, Path(job.output.motions)
    stage1 = replace(job.section(Stage1Config, "stage1"), **size)
    chart = job.section(ChartConfig, "chart")
    for place in batch_of(Path(job.input.data), int(job.wildcards.batch), job.params.size):
        each(place, out / place.name, lambda place, out: encode(place, out, stage1, chart))
    sign(out, Path(job.input.seal), job.header)
