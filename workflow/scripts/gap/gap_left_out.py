"""Diagnose a batch of recordings with their true effect left out of the catalogue."""

from pathlib import Path

from lagsplat.diagnose.core.config import DiagnoseConfig
from lagsplat.pipelines.batch import predict_recording, read_batch, write_provenance
from lagsplat.planning.job import Job

with Job(snakemake) as job:
    config, out = job.section(DiagnoseConfig), Path(job.output.said)
    data = job.input.data  # one folder of trajectories, or one for each batch of films
    folders = [Path(folder) for folder in ([data] if isinstance(data, str) else data)]
    batch = read_batch(Path(job.input.runs), folders, int(job.wildcards.batch), job.params.size)
    for place, without in batch.items():
        predict_recording(place, out / place.name, config, without=without)
    write_provenance(out, Path(job.input.seal), job.header)
