"""Train an autoencoder on each nominal film of a batch, freeze it, and write what it sees in every film."""

from dataclasses import replace
from pathlib import Path

from lagsplat.chart.config import ChartConfig
from lagsplat.pipelines.batch import attempt, encode_videos, list_batch, write_provenance
from lagsplat.planning.job import Job
from lagsplat.stage1.config import Stage1Config

with Job(snakemake) as job:
    size, out = job.params.film, Path(job.output.motions)
    stage1 = replace(job.section(Stage1Config, "stage1"), **size)
    chart = job.section(ChartConfig, "chart")
    for place in list_batch(Path(job.input.data), int(job.wildcards.batch), job.params.size):
        attempt(place, out / place.name, lambda place, out: encode_videos(place, out, stage1, chart))
    write_provenance(out, Path(job.input.seal), job.header)
