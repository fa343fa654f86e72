"""Make pictures of a recording's instants from other sides."""

from pathlib import Path

from lagsplat.io.config import RecordingConfig
from lagsplat.io.recording.recording import load_recording
from lagsplat.novel_views.sharp import obtain_views
from lagsplat.planning.job import Job
from lagsplat.systems.config import ReleaseConfig
from lagsplat.systems.truth import load_truth
from lagsplat.views.config import ViewsConfig
from lagsplat.views.novel import save_views

with Job(snakemake) as job:
    views = obtain_views(
        job.section(ViewsConfig),
        load_recording(job.input.recording),
        job.section(RecordingConfig, "source"),
        released=job.choice(ReleaseConfig, "release"),
        states=load_truth(job.input.truth)[0].states if job.input.truth else None,
        cache=Path(job.params.cache),
    )
    save_views(job.output.views, views, job.header)
