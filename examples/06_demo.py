"""From a film to a simulation that can be pushed, and to what it lacks beside another film, in two minutes.

    python examples/06_demo.py [FOLDER] [--fitted] [--no-browser]

Fits a small film of a rocker and exports a page; then diagnoses a film of the same rocker with three times
its damping. ``--fitted`` takes the fitted run that comes with the demo, as does a failed fit; both say so.
"""

import os
import shutil
import sys
import webbrowser
from pathlib import Path

import lagsplat
from lagsplat.io.recording.recording import save_recording
from lagsplat.io.recording.segments import split_train_held_out
from lagsplat.runs.fit import obtain_recording

DEMO = Path(__file__).parent / "demo"
FITTED = DEMO / "fitted"
FILM = os.path.relpath(DEMO / "rocker.mp4")
SETTINGS = (  # such as `lagsplat inspect examples/demo/rocker.mp4` proposes, with a shorter training
    *("profile=quick", "recording=filmed", "recording.kind=video", f"recording.path={FILM!r}"),
    *("recording.n_inputs=0", "recording.height=64", "recording.width=96"),
    *("system=rainbow_rocker", "chart.smoothing_frames=0.67", "stage1.steps=2000"),
)


def obtain_run(folder: Path, *, fitted: bool) -> None:
    """Fit the run, or copy the one that comes with the demo."""
    experiment = lagsplat.compose(*SETTINGS)
    try:
        if not fitted:
            lagsplat.fit_run(experiment, out=folder)
            return
    except (OSError, ValueError, RuntimeError) as error:
        print(f"the fit failed: {error}")
    print(f"taken instead of a fit of your own: the fitted run that comes with the demo, {FITTED}")
    recording, _ = obtain_recording(experiment)
    save_recording(
        folder / "recording.safetensors", split_train_held_out(recording, experiment.recording.split)
    )
    shutil.copytree(FITTED, folder, dirs_exist_ok=True)


options = {word for word in sys.argv[1:] if word.startswith("--")}
folder = Path(next((word for word in sys.argv[1:] if word not in options), "demo"))
obtain_run(folder / "rocker", fitted="--fitted" in options)
page = lagsplat.export_page(folder / "rocker", folder / "rocker.html")
diagnosis = lagsplat.diagnose(folder / "rocker", DEMO / "rocker_damped.mp4", out=folder / "diagnosis")
report = folder / "diagnosis" / "report.html"
print(diagnosis, f"push it: {page}", f"why the films differ: {report}", sep="\n")
for path in () if "--no-browser" in options else (page, report):
    webbrowser.open(path.resolve().as_uri())
