"""Training of stage 1 and of the baselines: steps, rates, curve, progress bar and checkpoints."""

import math
import time
from collections.abc import Callable, Collection
from typing import Any, TypeVar

import numpy as np
from tqdm import tqdm

CURVE_POINTS = 400  # rows of the training curve, for a run of any length
P = TypeVar("P", bound=tuple[Any, ...])  # a row of the curve; its first field is the step


def run_training(
    take_step: Callable[[int], np.ndarray | None],
    curve: list[P],
    make_point: Callable[..., P],
    *,
    n_steps: int,
    n_terms: int,
    title: str,
    save: Callable[[], None],
    save_every_s: float,
    ends: Collection[int] = (),
    images_per_step: int | None = None,
) -> None:
    """Take the steps that are left of a run, and extend its curve by the means since the previous point.

    Args:
        take_step: takes a step and returns its terms, the loss first; None counts in no mean.
        curve, make_point: points of an interrupted run, and what makes one of a number of steps, the means
            and the total seconds of training, those in the last point's ``seconds`` included.
        n_steps, n_terms, title: of the whole run, of a step, of the progress bar.
        save, save_every_s: writes a checkpoint, and how often [s].
        ends: steps that get a point in any case.
        images_per_step: makes the progress bar count images; it counts steps otherwise.
    """
    first = curve[-1][0] if curve else 0
    sums, counted = np.zeros(n_terms), 0
    saved_at = time.monotonic()
    started_at = saved_at - (getattr(curve[-1], "seconds", 0.0) if curve else 0.0)
    size = images_per_step or 1
    unit = "step" if images_per_step is None else "image"
    with tqdm(total=n_steps * size, initial=first * size, unit=unit, desc=title, mininterval=1.0) as bar:
        for step in range(first, n_steps):
            terms = take_step(step)
            if terms is not None:
                sums, counted = sums + terms, counted + 1
            bar.update(size)
            if (step + 1) % max(1, n_steps // CURVE_POINTS) and step + 1 not in ends:
                continue
            means = sums / counted if counted else np.full(n_terms, np.nan)
            curve.append(make_point(step + 1, *means.tolist(), time.monotonic() - started_at))
            bar.set_postfix(loss=means[0])
            sums, counted = np.zeros(n_terms), 0
            # The running means are empty only here, so a checkpoint need not hold them.
            if time.monotonic() - saved_at > save_every_s:
                save()
                saved_at = time.monotonic()


def decay_by_cosine(step: int | float, steps: int, *, final: float, initial: float = 1.0) -> float:
    """A value that goes from ``initial`` to ``final`` on a half cosine, after ``step`` of ``steps``."""
    return final + (initial - final) * (0.5 * (1.0 + math.cos(math.pi * step / steps)))
