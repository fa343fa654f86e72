"""Draw a long rollout beside the recording."""

from lagsplat.chart.chart import load_chart
from lagsplat.evaluate.config import EvaluateConfig
from lagsplat.evaluate.long_rollout import FineDecoder, compute_long_rollout
from lagsplat.io.recording.recording import load_recording
from lagsplat.planning.job import Job
from lagsplat.report.common.style import save_figures
from lagsplat.report.figures.rollout import draw_rollout
from lagsplat.stage1.autoencoder import load_autoencoder
from lagsplat.stage2.fit import load_dynamics

with Job(snakemake) as job:
    autoencoder, _ = load_autoencoder(job.input.autoencoder)
    chart, _ = load_chart(job.input.chart)
    lagrangian, _ = load_dynamics(job.input.dynamics)
    recording = load_recording(job.input.recording)
    fine = None
    if job.input.decoder:
        fine = FineDecoder(load_autoencoder(job.input.decoder)[0], load_recording(job.input.fine))
    view = compute_long_rollout(
        autoencoder, chart, lagrangian, recording, job.section(EvaluateConfig), fine=fine
    )
    figure = draw_rollout(view, title=job.title(f"Rollout, {job.wildcards.stage2} dynamics"))
    save_figures(job.output, figure)
