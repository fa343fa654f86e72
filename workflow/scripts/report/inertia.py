"""Draw the mass matrices of one system along its held-out motion, one form beside the other."""

import torch

from lagsplat.chart.chart import load_chart
from lagsplat.planning.job import Job
from lagsplat.report.common.style import save_figures
from lagsplat.report.figures.equilibrium import draw_inertia
from lagsplat.report.tables.learned_physics import LEARNED_MASS, MASS_TITLES
from lagsplat.stage2.fit import load_dynamics

with Job(snakemake) as job:
    chart, _ = load_chart(job.input.chart)
    states = chart.latents[chart.n_train :].astype("float64")
    forms = []
    for name, path in zip(job.params.names, job.input.dynamics, strict=True):
        with torch.no_grad():
            matrices = load_dynamics(path)[0].mass(torch.from_numpy(states)).double().numpy()
        forms.append((MASS_TITLES.get(name, LEARNED_MASS), matrices))
    save_figures(job.output, draw_inertia(forms, states, title=job.params.title))
