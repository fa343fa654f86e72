"""Choose the recordings that are diagnosed again with their effect left out of the catalogue."""

from pathlib import Path

from lagsplat.planning.job import Job

with Job(snakemake) as job:
    answers = ["--answers", job.input.seal, "--key", f"@{Path(job.params.key).expanduser()}"]
    job.command("benchmarks.gapgen.runs", *answers, "--most", job.params.most, "--out", job.output.runs)
