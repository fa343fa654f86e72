"""Let another method name the effects of a batch of recordings."""

import json
from pathlib import Path

from lagsplat.pipelines.batch import list_batch, write_provenance
from lagsplat.planning.job import Job

with Job(snakemake) as job:
    out = Path(job.output.said)
    places = list_batch(Path(job.input.data), job.params.number, job.params.size)
    settings = ["--method", job.wildcards.method, "--out", out, "--settings", json.dumps(job.params.cfg)]
    job.command("benchmarks.gap_baselines.predict", *settings, *places)
    write_provenance(out, Path(job.input.seal), job.header)
