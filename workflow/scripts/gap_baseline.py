"""Let another method name the effects of a batch of recordings."""

import json
from pathlib import Path

from lagsplat.pipelines.batch import batch_of, sign
from lagsplat.planning.job import Job

with Job(snakemake) as job:
    out = Path(job.output.said)
    places = batch_of(Path(job.input.data), job.params.number, job.params.size)
    settings = ["--method", job.wildcards.method, "--out", out, "--settings", json.dumps(job.params.cfg)]
    job.command("benchmarks.gap_baselines.predict", *settings, *places)
    sign(out, Path(job.input.seal), job.header)
