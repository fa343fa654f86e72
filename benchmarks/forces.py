"""Cost of a force in the picture: the pull-back and one dynamics step, as an interactive loop takes them.

Run as ``python benchmarks/forces.py [RUN ...]``; without folders of fitted runs, on laws of the default form
with one and with four coordinates. The comparison is with a step of the batched law without a force, in
the same process.
"""

import statistics
import sys
import time
from collections.abc import Callable
from pathlib import Path

import numpy as np
import torch

from lagsplat.config.compose import compose
from lagsplat.runs.run import open_run
from lagsplat.stage2.config import FormConfig
from lagsplat.stage2.lagrangian import Coefficients, Floors, Lagrangian
from lagsplat.stage2.numpy_lagrangian import NumpyLagrangian
from lagsplat.stage2.rollout import advance, split_inputs

REPEATS = 400


def default_law(d: int, n_inputs: int, form: FormConfig) -> Lagrangian:
    eye = torch.eye(d, dtype=torch.float64)
    start = Coefficients(eye, 0.2 * eye, eye, torch.ones(n_inputs, d, dtype=torch.float64), 0.0 * eye[0])
    return Lagrangian(start, form=form, floors=Floors(1e-2, 1e-3, 1e-2), time_unit_s=0.1, seed=0)


def milliseconds(action: Callable[[], object]) -> tuple[float, float]:
    """Median and least of many."""
    taken = []
    for _ in range(REPEATS):
        began = time.perf_counter()
        action()
        taken.append(1e3 * (time.perf_counter() - began))
    return statistics.median(taken), min(taken)


@torch.no_grad()
def measure(name: str, law: Lagrangian, dt_s: float) -> None:
    single, jacobian = NumpyLagrangian(law), np.ones((2, law.d))
    q, v, u, force = np.zeros(law.d), np.zeros(law.d), np.zeros(law.n_inputs), np.array([0.3, -0.2])
    start = (torch.from_numpy(x)[None] for x in (q, v, u))
    batched, ready = tuple(start), law.prepare()
    step = dt_s / float(law.time_unit_s)
    pushed = milliseconds(lambda: single.step(q, v, u, force @ jacobian, dt_s=dt_s))
    pull = milliseconds(lambda: force @ jacobian)
    free = milliseconds(lambda: advance(law, *batched, step=step, ready=ready))
    print(
        f"{name}, {split_inputs(step, law.longest_step)} Verlet steps: force step {pushed[0]:.3f} ms "
        f"(least {pushed[1]:.3f}), of it the pull-back {pull[0]:.4f} ms; the batched law without a force "
        f"{free[0]:.3f} ms (least {free[1]:.3f})"
    )


def main() -> None:
    torch.set_num_threads(1)
    for folder in sys.argv[1:]:
        run = open_run(Path(folder))
        measure(folder, run.lagrangian, run.chart.dt_s)
    if not sys.argv[1:]:
        form = compose().stage2.form
        for d, n_inputs in ((1, 0), (4, 4)):
            measure(f"d = {d}", default_law(d, n_inputs, form), 0.005)


if __name__ == "__main__":
    main()
