"""Draw how matter moves, and compare it with the true motion of material points where this is known."""

from lagsplat.chart.chart import load_chart
from lagsplat.evaluate.material_paths import follow_material_points
from lagsplat.io.files.atomic import save_json
from lagsplat.io.recording.recording import load_recording
from lagsplat.matter.field import load_matter
from lagsplat.matter.rest_picture import show_mean_state
from lagsplat.planning.job import Job
from lagsplat.report.common.style import save_figures
from lagsplat.report.figures.matter import draw_matter
from lagsplat.stage1.autoencoder import load_autoencoder
from lagsplat.systems.config import ReleaseConfig, SimulationConfig
from lagsplat.systems.pushable import make_pushable
from lagsplat.systems.truth import load_truth

with Job(snakemake) as job:
    chart, _ = load_chart(job.input.chart)
    matter, header = load_matter(job.input.matter)
    autoencoder, _ = load_autoencoder(job.input.autoencoder)
    frames = load_recording(job.input.recording).frames[: chart.n_train]
    paths = None
    if job.input.truth:
        truth, _ = load_truth(job.input.truth)
        system = make_pushable(
            job.choice(SimulationConfig, "simulation"),
            job.choice(ReleaseConfig, "release"),
            pressure=chart.train.inputs.mean(0),
            points=job.params.points,
            in_space=matter.space == 3,
        )
        paths = follow_material_points(matter, chart, system, truth)
    picture = show_mean_state(frames, chart.train.latents)
    figure = draw_matter(matter, picture, paths, title=job.title("Matter"), lens=autoencoder.lens)
    save_figures((job.output.pdf, job.output.png), figure)
    found = {"bodies": header["report"]["bodies"], "truth": None if paths is None else paths.measure()}
    save_json(job.output.metrics, found | {"made_by": job.header})
