"""Score and draw what held-out cameras saw."""

from lagsplat.evaluate.novel_views import score_novel_views
from lagsplat.io.files.atomic import save_json
from lagsplat.io.recording.recording import load_recording
from lagsplat.planning.job import Job
from lagsplat.report.common.style import save_figures
from lagsplat.report.figures.model_comparison import draw_novel_views
from lagsplat.stage1.autoencoder import load_autoencoder
from lagsplat.views.novel import load_views

with Job(snakemake) as job:
    recording, views = load_recording(job.input.recording), load_views(job.input.views)
    autoencoder, _ = load_autoencoder(job.input.autoencoder)
    scores = score_novel_views(autoencoder, recording, views)
    job.say({name: scores[name] for name in ("held_out", "filmed")})
    save_json(job.output.metrics, scores | {"made_by": job.header})
    figure = draw_novel_views(autoencoder, recording, views, title=job.title("Other sides"))
    save_figures((job.output.pdf, job.output.png), figure)
