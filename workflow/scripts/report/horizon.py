"""Draw the image error of every model along the same long rollouts."""

from collections import defaultdict

from lagsplat.baselines.config import BASELINE_TITLES
from lagsplat.io.files.atomic import load_json
from lagsplat.planning.job import Job
from lagsplat.report.common.style import save_figures
from lagsplat.report.figures.training_curves import draw_horizon, join_seeds

with Job(snakemake) as job:
    ours, laws, images = [], defaultdict(list), defaultdict(list)
    for path in job.input.metrics:
        found = load_json(path)
        baseline = found["made_by"]["wildcards"].get("baseline")
        if baseline:
            images[BASELINE_TITLES.get(baseline, baseline)].append(found["horizon"])
        elif "predictors" not in found:
            ours.append(found["horizon"])
        else:
            for name, scores in found["predictors"].items():
                if scores["dynamics"] != "none":
                    laws[name].append(scores["horizon"])
    groups = {
        title: [(name, join_seeds(seeds)) for name, seeds in models.items()]
        for title, models in (
            ("Other laws of the same latents", laws),
            ("Published models of images", images),
        )
        if models
    }
    save_figures(job.output, draw_horizon(("LaGSplat", join_seeds(ours)), groups, title=job.params.title))
