"""Diagnose a batch of recordings; nothing is known of them but their files."""

from pathlib import Path

from lagsplat.diagnose.core.config import DiagnoseConfig
from lagsplat.pipelines.batch import list_batch, predict_recording, write_provenance
from lagsplat.planning.job import Job

with Job(snakemake) as job:
    config, out = job.section(DiagnoseConfig), Path(job.output.said)
    for place in list_batch(Path(job.input.data), job.params.number, job.params.size):
        predict_recording(place, out / place.name, config)
    write_provenance(out, Path(job.input.seal), job.header)
