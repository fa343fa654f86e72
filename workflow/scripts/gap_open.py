"""Choose the recordings that are diagnosed again with their effect left out of the catalogue."""

from pathlib import Path

from lagsplat.job import Job

with Job(snakemake) as job:
    words = [
        "--answers",
        job.input.seal,
        "--key",
        f"@{Path(job.params.key).expanduser()}",
        "--most",
        job.params.most,
    ]
    job.command("benchmarks.gapgen.runs", *words, "--out", job.output.runs)
