"""Push a fitted run at a point of its image, let go, and keep it as a web page to be pushed by hand.

python examples/03_push_it.py FOLDER
"""

import sys
from pathlib import Path

import numpy as np

import lagsplat

folder = Path(sys.argv[1] if len(sys.argv) > 1 else "run")
run = lagsplat.open_run(folder)

# Where the image moves most, and along which direction; the force drives the state through half of its range.
at, direction = lagsplat.find_lever(run)
states, _ = lagsplat.push(run, at, direction, share=0.5, hold_s=1.0, duration_s=4.0)
away = np.linalg.norm(states - states[0], axis=1)
held = round(1.0 / run.chart.dt_s)
print(f"pushed at ({at[0]:.0f}, {at[1]:.0f}) px along ({direction[0]:+.2f}, {direction[1]:+.2f})")
print(
    f"{away[held]:.2f} away when let go, {away.max():.2f} at most, {away[-1]:.2f} in the end [whitened units]"
)

page = lagsplat.export_page(folder, folder / "run.html")
print(f"open {page} and pull the image")
