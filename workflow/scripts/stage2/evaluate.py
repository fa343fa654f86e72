"""Score one run on the held-out part of its recording."""

from lagsplat.chart.chart import load_chart
from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.evaluate import evaluate
from lagsplat.evaluate.truth import compare_with_truth
from lagsplat.io.files.atomic import load_json, save_json
from lagsplat.io.recording.recording import load_recording
from lagsplat.planning.job import Job
from lagsplat.stage1.autoencoder import load_autoencoder
from lagsplat.stage2.fit import load_dynamics, load_parameter_draws
from lagsplat.systems.truth import load_truth

with Job(snakemake) as job:
    autoencoder, header = load_autoencoder(job.input.autoencoder)
    chart, _ = load_chart(job.input.chart)
    lagrangian, _ = load_dynamics(job.input.dynamics)
    recording = load_recording(job.input.recording)
    metrics = evaluate(autoencoder, chart, lagrangian, recording, job.section(EvaluateConfig))
    if job.input.truth:
        truth, _ = load_truth(job.input.truth)
        metrics["truth"] = compare_with_truth(
            metrics, truth, chart, lagrangian, draws=load_parameter_draws(job.input.dynamics)
        )
    made = header["settings"]["cfg"]
    spent = {"steps": made["steps"], "frames_seen": made["steps"] * made["batch"]}
    metrics["training"] = {**spent, "wall_s": sum(load_json(path)["wall_s"] for path in job.input.records)}
    save_json(job.output.metrics, metrics | {"made_by": job.header})
