"""Fit the encoder and the Gaussians to the training part of a recording."""

from pathlib import Path

from lagsplat.io.files.atomic import save_csv
from lagsplat.io.recording.recording import load_recording
from lagsplat.planning.job import Job
from lagsplat.stage1.autoencoder import save_autoencoder
from lagsplat.stage1.config import Stage1Config
from lagsplat.stage1.fit import fit_autoencoder
from lagsplat.stage1.linear_response import InputHistory
from lagsplat.views.config import ViewsConfig
from lagsplat.views.novel import load_views

with Job(snakemake) as job:
    train, _ = load_recording(job.input.recording).split()
    config, checkpoint = job.section(Stage1Config), Path(job.params.checkpoint)
    views = job.choice(ViewsConfig, "views")
    autoencoder, curve = fit_autoencoder(
        train.frames,
        config,
        seed=job.seed,
        checkpoint=checkpoint,
        identity=job.identity,
        novel=load_views(job.input.views).first(train.n_frames) if job.input.views else None,
        supervision=None if views is None else views.supervision,
        history=InputHistory(train.inputs, train.segments),
    )
    save_autoencoder(job.output.autoencoder, autoencoder, job.header)
    save_csv(job.output.curve, [point._asdict() for point in curve])
    checkpoint.unlink(missing_ok=True)
