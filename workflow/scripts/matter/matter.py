"""Find the bodies of a film, and how they move with the state."""

from lagsplat.chart.chart import load_chart
from lagsplat.io.recording.recording import load_recording
from lagsplat.matter.config import MatterConfig
from lagsplat.matter.field import save_matter
from lagsplat.matter.fit import fit_matter
from lagsplat.planning.job import Job

with Job(snakemake) as job:
    chart, _ = load_chart(job.input.chart)
    frames = load_recording(job.input.recording).frames[: chart.n_train]
    matter, report = fit_matter(frames, chart.train.latents, job.section(MatterConfig), seed=job.seed)
    for body in report.bodies:
        job.say(body)
    for warning in report.warnings:
        job.say(warning)
    save_matter(job.output.matter, matter, job.header, report)
