"""Push a fitted run where its picture moves most; film, simulation and answer as a moving picture."""

from lagsplat.chart.chart import load_chart
from lagsplat.forces.operating_point import hold_at_load
from lagsplat.io.recording.recording import load_recording
from lagsplat.matter.field import load_matter
from lagsplat.planning.job import Job
from lagsplat.report.figures.push_animation import compute_push_view, save_push_animation
from lagsplat.stage1.autoencoder import load_autoencoder
from lagsplat.stage2.fit import load_dynamics

with Job(snakemake) as job:
    loads = (load_autoencoder, load_chart, load_dynamics, load_matter)
    point = hold_at_load(*(load(path)[0] for load, path in zip(loads, job.input.run, strict=True)))
    view = compute_push_view(point, load_recording(job.input.recording).frames)
    save_push_animation(job.output.gif, view, title=job.params.title)
