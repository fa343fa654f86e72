"""Train a key-point forecaster on the training frames of the clip that crosses into the held-out ones."""

from pathlib import Path

from lagsplat.baselines.config import ForecasterConfig
from lagsplat.baselines.keypoints.fit import fit_forecaster
from lagsplat.baselines.keypoints.model import save_forecaster
from lagsplat.io.files.atomic import save_csv
from lagsplat.io.recording.recording import load_recording
from lagsplat.io.recording.segments import find_crossing_frames
from lagsplat.planning.job import Job

with Job(snakemake) as job:
    recording, checkpoint = load_recording(job.input.recording), Path(job.params.checkpoint)
    start, boundary, _ = find_crossing_frames(recording.segments, recording.split()[0].n_frames)
    forecaster, curve = fit_forecaster(
        recording.frames[start:boundary],
        job.section(ForecasterConfig),
        seed=job.seed,
        checkpoint=checkpoint,
        identity=job.identity,
    )
    save_forecaster(job.output.model, forecaster, {**job.header, "wall_s": curve[-1].seconds})
    save_csv(job.output.curve, [point._asdict() for point in curve])
    checkpoint.unlink(missing_ok=True)
