"""What each part of the registration of matter gains: errors of the found motion with one part left out.

Run as ``python benchmarks/matter.py RUN ...`` with folders of fitted runs on simulated recordings, whose last
but two folder is the name of the system. All variants are fitted in one process, to the same frames.
"""

import sys
from collections.abc import Callable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path
from unittest.mock import patch

import numpy as np
import torch

from lagsplat.config.compose import compose
from lagsplat.evaluate.material_paths import follow_material_points
from lagsplat.matter import film_registration
from lagsplat.matter.body_motion import BodyMotion
from lagsplat.matter.config import MatterConfig
from lagsplat.matter.fit import fit_matter
from lagsplat.matter.registration import Patch, estimate_scale, measure_residuals
from lagsplat.runs.run import FittedRun, locate_artefact, open_run
from lagsplat.systems.pushable import make_pushable
from lagsplat.systems.truth import load_truth

LEGS, read_patch = film_registration.LEGS, film_registration.FilmRegistration._read_patch


def change_steps(**constants: object) -> Callable[[], AbstractContextManager]:
    """Other constants of the registration."""
    return lambda: patch.multiple(film_registration, **constants)


def read_patch_of_movers(*args: object) -> Patch:
    """A patch of which every point counts as if it moved."""
    read = read_patch(*args)  # type: ignore[arg-type]
    return replace(read, away=torch.ones_like(read.away))


def keep_motion(
    film: film_registration.FilmRegistration,
    motion: BodyMotion,
    points: Patch,
    level: int,
    chosen: np.ndarray,
) -> tuple[BodyMotion, float]:
    """The motion as it was, and the scale of its loss."""
    frames = torch.from_numpy(chosen)
    left = measure_residuals(film._select(level, frames), points, motion, film.q[frames])
    return motion, estimate_scale(left, points.texture, noise=film.noise)


@dataclass(frozen=True)
class Variant:
    """One part left out: other settings, or other code."""

    name: str
    settle: Callable[[MatterConfig], MatterConfig] = lambda config: config
    change: Callable[[], AbstractContextManager] = nullcontext


VARIANTS = (
    Variant("everything"),
    Variant("no averaged picture", change=change_steps(AVERAGES=0)),
    Variant("straight ways", settle=lambda config: replace(config, latent_degree=1)),
    Variant("one rigid body", settle=lambda config: replace(config, bending=0, bodies=1)),
    Variant("near frames only", change=change_steps(LEGS=LEGS[:3])),
    Variant(
        "derivative of the picture",
        change=lambda: patch.object(film_registration.FilmRegistration, "_register", keep_motion),
    ),
    Variant(
        "still points count alike",
        change=lambda: patch.object(film_registration.FilmRegistration, "_read_patch", read_patch_of_movers),
    ),
)


def measure(run: FittedRun, variant: Variant, system_name: str) -> str:
    """Errors of the motion that a variant finds, and its seconds."""
    settings = compose(f"system={system_name}", "profile=quick")
    assert run.folder is not None
    truth, _ = load_truth(locate_artefact(run.folder, "truth"))
    system = make_pushable(
        settings.simulation,
        settings.release,
        pressure=run.chart.train.inputs.mean(0),
        points=5,
        in_space=False,
    )
    with variant.change():
        frames = run.recording.split()[0].frames
        matter, report = fit_matter(frames, run.chart.train.latents, variant.settle(settings.matter))
    found = follow_material_points(matter, run.chart, system, truth).measure()
    bodies = ", ".join(f"degree {body.bending}" for body in report.bodies)
    return (
        f"{variant.name:28} path {found['path']:6.1%}  direction {found['direction_deg']:5.1f} deg  "
        f"shape {found['shape']:6.1%}  {report.wall_s:5.0f} s  {bodies}"
    )


def main() -> None:
    torch.set_num_threads(1)
    for folder in map(Path, sys.argv[1:]):
        name = folder.resolve().parts[-3]
        print(name)
        for variant in VARIANTS:
            print("  " + measure(open_run(folder), variant, name), flush=True)


if __name__ == "__main__":
    main()
