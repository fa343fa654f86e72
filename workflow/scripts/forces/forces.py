"""Push a fitted run in the picture, and compare its answers with the true ones where these are known."""

from lagsplat.chart.chart import load_chart
from lagsplat.evaluate.forces.motion import measure_forces
from lagsplat.forces.config import ForcesConfig
from lagsplat.forces.operating_point import hold_at_load
from lagsplat.io.files.atomic import save_json
from lagsplat.matter.field import load_matter
from lagsplat.planning.job import Job
from lagsplat.stage1.autoencoder import load_autoencoder
from lagsplat.stage2.fit import load_dynamics
from lagsplat.systems.config import ReleaseConfig, SimulationConfig
from lagsplat.systems.truth import load_truth

with Job(snakemake) as job:
    loads = (load_autoencoder, load_chart, load_dynamics, load_matter)
    files = (job.input.autoencoder, job.input.chart, job.input.dynamics, job.input.matter)
    metrics = measure_forces(
        hold_at_load(*(load(path)[0] for load, path in zip(loads, files, strict=True))),
        job.section(ForcesConfig),
        truth=load_truth(job.input.truth)[0] if job.input.truth else None,
        driven=job.choice(SimulationConfig, "simulation"),
        released=job.choice(ReleaseConfig, "release"),
    )
    save_json(job.output.metrics, metrics | {"made_by": job.header})
