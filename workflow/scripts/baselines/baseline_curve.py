"""Draw the training curve of a baseline."""

import pandas as pd

from lagsplat.baselines.config import BASELINE_TITLES
from lagsplat.io.files.artifact import read_header
from lagsplat.planning.job import Job
from lagsplat.report.common.style import save_figures
from lagsplat.report.figures.training_curves import draw_curves

with Job(snakemake) as job:
    names = ["loss", "reconstruction", "ahead", "latent", "validation"]
    curve = pd.DataFrame(read_header(job.input.model)["training"]["curve"], columns=["step", *names])
    curve = curve.dropna(axis="columns", how="all")  # of a run without validation
    labels = {"reconstruction": "a frame", "ahead": "the next frame", "latent": "its state"}
    labels["validation"] = "half a second ahead, withheld"
    name = job.wildcards.baseline
    title, unit = job.title(f"Training of {BASELINE_TITLES.get(name, name)}"), "mean squared error"
    figure = draw_curves(curve, title=title, columns=list(curve)[1:], labels=labels, unit=unit)
    save_figures(job.output, figure)
