"""Fit a simulation to one video, or to the recording of a simulated arm where no video is given.

    python examples/01_fit_a_video.py FOLDER [VIDEO] [key=value ...]

Further words are settings of conf/, such as profile=toy (minutes become seconds) or system.d=2.
"""

import sys

import lagsplat

folder, *words = sys.argv[1:] or ["run"]
settings = [word for word in words if "=" in word]
videos = [word for word in words if "=" not in word]
if videos:
    settings = ["recording=filmed", "recording.kind=video", f"recording.path={videos[0]!r}", *settings]

experiment = lagsplat.compose(*settings)
run = lagsplat.fit_run(experiment, out=folder)

recording = run.recording
print(f"{recording.n_frames} frames of {recording.width} x {recording.height} px, {recording.n_train} to fit")
print(f"{run.autoencoder.gaussians.n} Gaussians move with {run.chart.d} coordinates")
