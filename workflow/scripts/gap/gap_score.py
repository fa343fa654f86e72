"""Open a split and score the predictions of the diagnosis and of the other methods."""

from pathlib import Path

from lagsplat.planning.job import Job

with Job(snakemake) as job:
    out = Path(job.output.scores).parent
    said = {"diagnosis": job.input.diagnosis, "left_out": job.input.left_out}
    for name in job.params.baselines:
        said[name] = [path for path in job.input.others if Path(path).parent.name == name]
    trees = {}
    for name, folders in said.items():
        words = ["--seal", job.input.seal, "--out", out / "said" / name]
        trees[name] = job.command("benchmarks.gapgen.gather", *words, *folders)
    also = [f"--also={name}={out / 'said' / name}" for name in job.params.baselines]
    key = ["--answers", job.input.seal, "--key", f"@{Path(job.params.key).expanduser()}"]
    job.command(
        "benchmarks.gapgen.score",
        *key,
        *also,
        "--predictions",
        out / "said" / "diagnosis",
        "--left-out",
        out / "said" / "left_out",
        "--tree",
        trees["diagnosis"].strip(),
        "--out",
        out,
        *["--reveal"] * job.params.reveal,
    )
