"""Score the simple predictors, which any model must beat, on the held-out part of a recording."""

from lagsplat.chart.chart import load_chart
from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.simple_predictors import evaluate_simple_predictors
from lagsplat.io.files.atomic import save_json
from lagsplat.io.recording.recording import load_recording
from lagsplat.planning.job import Job
from lagsplat.stage1.autoencoder import load_autoencoder

with Job(snakemake) as job:
    autoencoder, _ = load_autoencoder(job.input.autoencoder)
    chart, _ = load_chart(job.input.chart)
    recording = load_recording(job.input.recording)
    scores = evaluate_simple_predictors(autoencoder, chart, recording, job.section(EvaluateConfig))
    save_json(job.output.metrics, {"predictors": scores, "made_by": job.header})
