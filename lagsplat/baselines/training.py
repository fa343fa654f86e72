"""The loop that trains every baseline: steps, curve, progress bar and checkpoints."""

import time
from collections.abc import Callable, Collection
from typing import Any, TypeVar

import numpy as np
from tqdm import tqdm

CURVE_POINTS = 400  # rows of the training curve, for a run of any length
P = TypeVar("P", bound=tuple[Any, ...])  # a row of the curve: its first field is the step, its last the time


def run_training(
    take_step: Callable[[int], np.ndarray | None],
    curve: list[P],
    make_point: Callable[..., P],
    *,
    n_terms: int,
    ends: Collection[int],
    title: str,
    save: Callable[[], None] | None,
    save_every_s: float,
) -> None:
    """Take the steps that are left of a run, and extend its curve by the means since the previous point.

    Args:
        take_step: takes a step and returns its terms, the loss first; None counts in no mean.
        curve, make_point: points of an interrupted run, and what makes one of a number of steps, the means
            and the total seconds of training without interruptions.
        n_terms, ends: number of terms, and steps that end a phase and so have a point; the last ends the run.
        title, save, save_every_s: of the progress bar; writes a checkpoint, and how often [s].
    """
    first, spent = (curve[-1][0], curve[-1][-1]) if curve else (0, 0.0)
    n_steps, sums, counted = max(ends), np.zeros(n_terms), 0
    saved_at = resumed_at = time.monotonic()
    with tqdm(total=n_steps, initial=first, unit="step", desc=title, mininterval=1.0) as bar:
        for step in range(first, n_steps):
            terms = take_step(step)
            if terms is not None:
                sums, counted = sums + terms, counted + 1
            bar.update()
            if (step + 1) % max(1, n_steps // CURVE_POINTS) and step + 1 not in ends:
                continue
            means = sums / counted if counted else np.full(n_terms, np.nan)
            curve.append(make_point(step + 1, *means.tolist(), spent + time.monotonic() - resumed_at))
            bar.set_postfix(loss=means[0])
            sums, counted = np.zeros(n_terms), 0
            # The running means are empty only here, so a checkpoint need not hold them.
            if save and time.monotonic() - saved_at > save_every_s:
                save()
                saved_at = time.monotonic()
