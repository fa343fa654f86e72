"""What a diagnosis shows while it runs: the checks of the data as soon as they are made, and its progress."""

import sys
from types import TracebackType
from typing import Self, TextIO

from tqdm import tqdm

from lagsplat.diagnose.core.config import SELECTION, DiagnoseConfig
from lagsplat.diagnose.data_quality.checks import DataCheck
from lagsplat.diagnose.effects.registry import catalogue

STAGES = (
    "read and check the data",
    "prepare the sim",
    "locate the gap",
    "plan the next experiment",
    "draw the figures",
)


def count_steps(config: DiagnoseConfig) -> int:
    """Count the steps of a diagnosis, at most: its stages, and the fits of single effects, pairs and triples.

    A search that ends early takes fewer; one that is repeated under a larger noise takes more.
    """
    known = len(set(catalogue()) - set(config.without))
    singles = min(2 * config.families + len(config.always_fitted), known)
    others = min(max(SELECTION.min_families, config.families // 2), known)
    return len(STAGES) + singles + (SELECTION.max_first_effects + SELECTION.max_effects - 2) * others


class ProgressDisplay:
    """A progress bar with a total from the start, below the lines on the data; use it in a ``with``."""

    def __init__(self, config: DiagnoseConfig, file: TextIO | None = None) -> None:
        form = "{desc:28.28} {bar} {n_fmt} of at most {total_fmt} [{elapsed}]"
        file = sys.stderr if file is None else file
        self._bar = tqdm(total=count_steps(config), leave=False, bar_format=form, file=file)
        self._bar.set_description(STAGES[0])
        self._shown: set[str] = set()

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._bar.close()

    def __call__(self, name: str, remaining: int | None = None) -> None:
        """Show that the step ``name`` begins; ``remaining`` are the steps after the last one, if known."""
        self._bar.update()
        if remaining is not None:
            self._bar.total = self._bar.n + remaining
        self._bar.total = max(self._bar.total, self._bar.n + 1)
        self._bar.set_description(name.replace("_", " "))

    def show_checks(self, checked: DataCheck) -> None:
        """Show what was checked of the data, and what is wrong with them."""
        real = checked.real
        duration_s = sum(motion.duration_s for motion in real.motions)
        period = "nothing swings" if real.period_s is None else f"natural period {real.period_s:.3g} s"
        names = real.motions[0].q_names
        noise = ", ".join(f"{name} {size:.2g}" for name, size in zip(names, real.noise.sigma, strict=True))
        samples = sum(motion.n for motion in real.motions)
        self.warn(f"data: {duration_s:.4g} s, {samples} samples; {period}; noise (rms) {noise}")
        for text in checked.warnings:
            self.warn(f"warning: {text}")

    def warn(self, text: str) -> None:
        """Show a line above the bar, once."""
        if text not in self._shown:
            self._shown.add(text)
            tqdm.write(text, file=self._bar.fp)
