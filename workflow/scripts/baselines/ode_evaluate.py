"""Score a neural differential equation on the held-out part of a recording."""

from lagsplat.baselines.config import ODE_TITLES
from lagsplat.baselines.neural_ode import load_ode
from lagsplat.chart.chart import load_chart
from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.neural_ode import evaluate_ode
from lagsplat.io.files.atomic import save_json
from lagsplat.io.recording.recording import load_recording
from lagsplat.planning.job import Job
from lagsplat.stage1.autoencoder import load_autoencoder

with Job(snakemake) as job:
    autoencoder, _ = load_autoencoder(job.input.autoencoder)
    chart, _ = load_chart(job.input.chart)
    ode, header = load_ode(job.input.model)
    recording, config = load_recording(job.input.recording), job.section(EvaluateConfig)
    scores = evaluate_ode(ode, autoencoder, chart, recording, config)
    scores["training"] = {"wall_s": header["wall_s"]}
    save_json(job.output.metrics, {"predictors": {ODE_TITLES[ode.structure]: scores}, "made_by": job.header})
