"""Draw held-out frames, their reconstruction and the error."""

from lagsplat.io.recording.recording import load_recording
from lagsplat.planning.job import Job
from lagsplat.report.common.style import save_figures
from lagsplat.report.figures.model_comparison import draw_reconstruction
from lagsplat.stage1.autoencoder import load_autoencoder

with Job(snakemake) as job:
    _, held_out = load_recording(job.input.recording).split()
    autoencoder, _ = load_autoencoder(job.input.autoencoder)
    figure = draw_reconstruction(autoencoder, held_out, title=job.title("Held-out frames"))
    save_figures(job.output, figure)
