"""Draw a batch of recordings whose truth is known."""

from lagsplat.planning.job import Job

with Job(snakemake) as job:
    batch, settings = job.wildcards.batch, job.params
    job.command(
        "benchmarks.gapgen.make",
        *("--split", f"calibration-{batch}", "--key", f"{settings.seed}-{batch}", "--n", settings.batch),
        *("--systems", settings.systems, "--out", job.output.data),
    )
