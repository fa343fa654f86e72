"""Find the bodies of a film, and how they move with the state."""

from lagsplat.chart.chart import load_chart
from lagsplat.io.recording.recording import load_recording
from lagsplat.matter.config import MatterConfig
from lagsplat.matter.field import save_matter
from lagsplat.matter.fit import fit_matter
from lagsplat.matter.scene import make_scene
from lagsplat.planning.job import Job
from lagsplat.stage1.autoencoder import load_autoencoder
from lagsplat.views.novel import load_views

with Job(snakemake) as job:
    chart, _ = load_chart(job.input.chart)
    frames = load_recording(job.input.recording).frames[: chart.n_train]
    views = load_views(job.input.views) if job.input.views else None
    scene = make_scene(load_autoencoder(job.input.autoencoder)[0], chart, views)
    matter, report = fit_matter(
        frames, chart.train.latents, job.section(MatterConfig), seed=job.seed, scene=scene
    )
    for body in report.bodies:
        job.say(body)
    for warning in report.warnings:
        job.say(warning)
    save_matter(job.output.matter, matter, job.header, report)
