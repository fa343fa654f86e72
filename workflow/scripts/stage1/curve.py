"""Draw the training curve of stage 1."""

import pandas as pd

from lagsplat.planning.job import Job
from lagsplat.report.common.style import save_figures
from lagsplat.report.figures.training_curves import draw_curves

with Job(snakemake) as job:
    figure = draw_curves(
        pd.read_csv(job.input.curve),
        title=job.title("Training of stage 1"),
        columns=["loss", "l1", "mse"],
        labels={"l1": "mean absolute error", "mse": "mean squared error"},
        unit="error of a frame (colour, 0 to 1)",
    )
    save_figures(job.output, figure)
