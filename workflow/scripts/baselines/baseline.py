"""Train a published model on the training part of a recording, or take its published weights."""

from dataclasses import replace
from pathlib import Path

from lagsplat.baselines.config import BaselineConfig
from lagsplat.baselines.fit import obtain_baseline
from lagsplat.baselines.model import save_baseline
from lagsplat.io.recording.recording import load_recording
from lagsplat.planning.job import Job

with Job(snakemake) as job:
    train, _ = load_recording(job.input.recording).split()
    config, checkpoint = job.section(BaselineConfig), Path(job.params.checkpoint)
    config = replace(config, weights=job.input.weights or None)
    baseline, story = obtain_baseline(
        train, config, seed=job.seed, checkpoint=checkpoint, identity=job.identity
    )
    save_baseline(job.output.model, baseline, {**job.header, "training": story})
    checkpoint.unlink(missing_ok=True)
