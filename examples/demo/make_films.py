"""Make the two films of the demo: a simulated rocker, and the same one with five times its damping.

python examples/demo/make_films.py FOLDER
"""

import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import lagsplat
from lagsplat.systems.config import ReleaseClipConfig
from lagsplat.systems.mechanism import make_mechanism, release
from lagsplat.systems.video import write_clips

folder = Path(sys.argv[1])
experiment = lagsplat.compose("system=rainbow_rocker")
assert experiment.release is not None
assert experiment.release.rocker is not None
n_frames = 300  # ten seconds
config = replace(
    experiment.release,
    clips=[ReleaseClipConfig(n_frames, [0.62], [0.0])],
    scene=replace(experiment.release.scene, film_scale=3, noise_levels=1.0),
)
time_s = config.dt_s * np.arange(n_frames)
for name, friction in (("rocker", 1.0), ("rocker_damped", 5.0)):
    rocker = replace(config.rocker, friction=friction * config.rocker.friction)
    mechanism = make_mechanism(replace(config, rocker=rocker))
    states, _ = release(
        mechanism,
        np.array([0.62]),
        np.array([0.0]),
        time_s=time_s,
        push=lambda t, q: np.zeros(1),
        rtol=config.rtol,
    )
    (path,) = write_clips(config, [mechanism.poses(states)], folder, seed=0)
    path.rename(folder / f"{name}.mp4")
