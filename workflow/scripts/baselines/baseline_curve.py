"""Draw the training curve of a baseline."""

import pandas as pd

from lagsplat.io.files.artifact import read_header
from lagsplat.planning.job import Job
from lagsplat.report.common.style import save_figure
from lagsplat.report.figures.training_curves import draw_curves

with Job(snakemake) as job:
    names = ["loss", "reconstruction", "ahead", "latent"]
    curve = pd.DataFrame(read_header(job.input.model)["training"]["curve"], columns=["step", *names])
    labels = {"reconstruction": "a frame, squared error", "ahead": "the next frame", "latent": "its state"}
    figure = draw_curves(curve, title=job.title("Baseline"), columns=names, labels=labels)
    save_figure(job.output.figure, figure)
