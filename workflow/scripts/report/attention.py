"""Draw the attention maps of the baselines that have them, at the first held-out frame."""

import numpy as np

from lagsplat.baselines.model import load_baseline
from lagsplat.evaluate.evaluate import make_picture_reader
from lagsplat.io.recording.recording import load_recording
from lagsplat.planning.job import Job
from lagsplat.report.common.style import save_figures
from lagsplat.report.figures.model_comparison import compute_attention, draw_attention

with Job(snakemake) as job:
    recording = load_recording(job.input.recording)
    (picture,) = make_picture_reader(recording, first=recording.split()[0].n_frames)(np.zeros(1, np.int64))
    models = zip(job.params.names, job.input.models, strict=True)
    maps = [compute_attention(name, load_baseline(path)[0], picture) for name, path in models]
    figure = draw_attention([found for found in maps if found], title=job.params.title)
    save_figures(job.output, figure)
