"""Fit the encoder and the Gaussians to the training part of a recording."""

from pathlib import Path

from lagsplat.io.plain import save_csv
from lagsplat.io.recording import load_recording
from lagsplat.job import Job
from lagsplat.stage1.autoencoder import save_autoencoder
from lagsplat.stage1.config import Stage1Config
from lagsplat.stage1.fit import fit_autoencoder

with Job(snakemake) as job:
    train, _ = load_recording(job.input.recording).split()
    config, checkpoint = job.section(Stage1Config), Path(job.params.checkpoint)
    autoencoder, curve = fit_autoencoder(
        train.frames, config, seed=job.seed, checkpoint=checkpoint, identity=job.identity
    )
    save_autoencoder(job.output.autoencoder, autoencoder, job.header)
    save_csv(job.output.curve, [point._asdict() for point in curve])
    checkpoint.unlink(missing_ok=True)
