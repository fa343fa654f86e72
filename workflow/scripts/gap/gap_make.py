"""Draw a split of recordings whose effect is withheld, and seal its answers."""

from pathlib import Path

from lagsplat.io.files.atomic import sha256_of
from lagsplat.planning.job import Job

with Job(snakemake) as job:
    path, key = job.wildcards, Path(job.params.key).expanduser()
    split = ["--split", f"{path.split}-{path.tier}", "--key", f"@{key}"]
    folder = Path(job.output.seal).parent
    job.command("benchmarks.gapgen.keys", key)
    job.command(
        "benchmarks.gapgen.make",
        *split,
        "--n",
        job.params.n,
        "--systems",
        job.params.systems,
        "--tier",
        path.tier,
        "--out",
        folder,
        "--jobs",
        job.threads,
    )
    job.command("benchmarks.gapgen.seal", *split, "--dir", folder)
    job.say(f"{job.output.seal} has SHA-256 {sha256_of(job.output.seal)}")
