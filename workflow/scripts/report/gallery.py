"""Draw every model from the same start."""

from lagsplat.baselines.model import load_baseline
from lagsplat.chart.chart import load_chart
from lagsplat.evaluate.baseline import make_baseline_subject
from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.evaluate import make_run_subject
from lagsplat.io.recording.recording import load_recording
from lagsplat.planning.job import Job
from lagsplat.report.common.style import save_figures
from lagsplat.report.figures.model_comparison import draw_comparison
from lagsplat.stage1.autoencoder import load_autoencoder
from lagsplat.stage2.fit import load_dynamics

with Job(snakemake) as job:
    recording, config = load_recording(job.input.recording), job.section(EvaluateConfig)
    loads = (load_autoencoder, load_chart, load_dynamics)
    parts = [load(path)[0] for load, path in zip(loads, job.input.run, strict=True)]
    models = {"LaGSplat": make_run_subject(*parts, recording, config)}
    for name, path in zip(job.params.names, job.input.models, strict=True):
        models[name] = make_baseline_subject(load_baseline(path)[0], recording, config)
    save_figures(job.output, draw_comparison(models, title=job.params.title))
