"""Diagnose a batch of recordings; nothing is known of them but their files."""

from pathlib import Path

from lagsplat.diagnose.core.config import DiagnoseConfig
from lagsplat.pipelines.batch import batch_of, predict, sign
from lagsplat.planning.job import Job

with Job(snakemake) as job:
    config, out = job.section(DiagnoseConfig), Path(job.output.said)
    for place in batch_of(Path(job.input.data), job.params.number, job.params.size):
        predict(place, out / place.name, config)
    sign(out, Path(job.input.seal), job.header)
