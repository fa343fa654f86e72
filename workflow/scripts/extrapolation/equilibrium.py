"""Draw where the long rollouts of all models end."""

from lagsplat.io.files.atomic import load_json
from lagsplat.planning.job import Job
from lagsplat.report.common.style import save_figures
from lagsplat.report.figures.equilibrium import draw_equilibrium

with Job(snakemake) as job:
    run, *_ = (load_json(path) for path in job.input.runs)
    models = {
        "key-point forecaster": [load_json(path) for path in job.input.forecasters],
        "neural ODE": [load_json(path) for path in job.input.odes],
    }
    figure = draw_equilibrium(run, models, title=job.params.title)
    save_figures((job.output.pdf, job.output.png), figure)
