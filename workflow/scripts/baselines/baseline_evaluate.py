"""Score a baseline on the held-out part of its recording."""

from lagsplat.baselines.model import load_baseline
from lagsplat.evaluate.baseline import evaluate_baseline
from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.io.files.atomic import save_json
from lagsplat.io.recording.recording import load_recording
from lagsplat.planning.job import Job

with Job(snakemake) as job:
    baseline, header = load_baseline(job.input.model)
    metrics = evaluate_baseline(baseline, load_recording(job.input.recording), job.section(EvaluateConfig))
    spent = {name: header["training"][name] for name in ("steps", "frames_seen", "wall_s", "epoch")}
    save_json(job.output.metrics, metrics | {"training": spent, "made_by": job.header})
