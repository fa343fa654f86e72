"""Find the bodies of a film, and how they move with the state."""

from lagsplat.chart.chart import load_chart
from lagsplat.io.recording.recording import load_recording
from lagsplat.matter.config import MatterConfig
from lagsplat.matter.field import make_no_matter, save_matter
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
    try:
        matter, report = fit_matter(
            frames, chart.train.latents, job.section(MatterConfig), seed=job.seed, scene=scene
        )
        for each in (*report.bodies, *report.warnings):
            job.say(each)
    except ValueError as error:  # a law can be learned all the same
        job.say(f"no matter, so that nothing can be pushed: {error}")
        matter, report = make_no_matter(chart.d, 2 if scene is None else 3), None
    save_matter(job.output.matter, matter, job.header, report)
