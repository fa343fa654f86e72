"""Make the two films of the demo: a simulated rocker, and the same one with three times its damping.

python examples/demo/make_films.py FOLDER
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import lagsplat
from lagsplat.systems.mechanism import make_mechanism, release
from lagsplat.systems.video import write_clips

folder = Path(sys.argv[1])
experiment = lagsplat.compose("system=rainbow_rocker")
assert experiment.release is not None
config = replace(
    experiment.release,
    scene=replace(experiment.release.scene, film_scale=3, noise_levels=1.0),
)
for name, friction, n_frames in (("rocker", 1.0, 300), ("rocker_damped", 3.0, 180)):
    assert config.rocker is not None
    rocker = replace(config.rocker, friction=friction * config.rocker.friction)
    mechanism = make_mechanism(replace(config, rocker=rocker))
    states, _ = release(
        mechanism,
        np.array([0.62]),
        np.array([0.0]),
        time_s=config.dt_s * np.arange(n_frames),
        push=lambda t, q: np.zeros(1),
        rtol=config.rtol,
    )
    (path,) = write_clips(config, [mechanism.poses(states)], folder, seed=0)
    path.rename(folder / f"{name}.mp4")
