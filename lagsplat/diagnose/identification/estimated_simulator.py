"""A sim beside a real recording, ready to be compared."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.core.config import DiagnoseConfig
from lagsplat.diagnose.data_quality.natural_period import estimate_spectral_period_s
from lagsplat.diagnose.estimation.dataset import (
    FileSpan,
    cut_windows,
    drop_overlapping_windows,
    locate_windows,
    prepare_dataset,
)
from lagsplat.diagnose.identification.novelty import (
    MIN_WINDOWS,
    POOR_MISFIT,
    NoveltyDetector,
    drop_outlier_windows,
)
from lagsplat.diagnose.identification.structure_search import IdentificationSettings, identify_model
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.mechanics.structure import COEFFICIENT_FIELDS
from lagsplat.io.trajectory.trajectory import Trajectory

DIVERGED_MISFIT = 50.0
"""Mean square residual, in units of the noise, beyond which a window is too long to be followed."""
SHORTER, SHORTEST = 0.35, 0.12
"""Shares of a window that can be followed past an unstable rest, as an upright pendulum's."""
FIT_TOLERANCE = 1e-4
"""Gain of a step below which a sim's own fit has ended, as a share of the misfit."""


@dataclass(frozen=True)
class EstimatedSimulator:
    """A model and what is not known about it."""

    model: MechanicalModel
    uncertainty_directions: Float64[np.ndarray, "R K"]
    """Changes of all coefficients of one standard deviation each."""
    misfit: float
    """Mean square residual on its own recordings in units of their noise."""
    correlation: float = 1.0
    """Samples of that residual that count as one."""
    reach: float = 1.0
    """How far ahead it can be run, in windows as long as the settings say."""
    original: "EstimatedSimulator | None" = None
    """As it was handed over, where it was moved since (`recalibrated`)."""
    novelty_detector: NoveltyDetector | None = None
    """How it was seen to move, if other stretches are to be left aside."""
    outlier_spans: tuple[FileSpan, ...] = ()
    """Stretches of its own recordings that no law tells beside the others, and that were left out."""
    cost: float = np.nan
    """Bayesian information criterion of a law that was found, beside others of the same recordings."""

    @classmethod
    def exact(cls, model: MechanicalModel) -> "EstimatedSimulator":
        """A sim that is given, so that nothing about it was estimated."""
        size = sum(getattr(model, name).size for name in COEFFICIENT_FIELDS)
        return cls(model, np.zeros((0, size)), 1.0)


def estimate_simulator(motions: Sequence[Trajectory], config: DiagnoseConfig) -> EstimatedSimulator:
    """The sim that made these recordings.

    Raises:
        ValueError: nothing moves, or no clip is long enough for a window.
    """
    period_s = estimate_spectral_period_s(motions)
    ready = prepare_dataset(motions, period_s=period_s)
    again = partial(
        identify_model, ready.dataset, ready.smooth, ready.sigma, period_s, make_identification_settings(config),
        held=config.input_hold == "zoh",
    )  # fmt: skip

    def told(reach: float, without: tuple[FileSpan, ...] = ()) -> EstimatedSimulator:
        length_s = reach * config.window_periods * period_s
        windows = cut_windows(ready.dataset, length_s=length_s, min_frames=12)
        kept = drop_overlapping_windows(windows, ready.dataset, without)
        if len(kept.first) >= MIN_WINDOWS:
            windows = kept
        found, odd = drop_outlier_windows(again(windows), again)
        all_odd = (*without, *locate_windows(odd, ready.dataset))
        model = move_rest_to_minimum(found.model, ready.smooth)
        return EstimatedSimulator(
            model,
            found.uncertainty_directions,
            found.misfit,
            reach=reach,
            outlier_spans=all_odd,
            cost=found.cost,
        )

    whole = told(1.0)
    if whole.misfit < DIVERGED_MISFIT:
        return whole
    short = told(SHORTEST)  # tells best where something else acted
    middle = told(SHORTER, short.outlier_spans)
    for one in (middle, short):
        if one.misfit < POOR_MISFIT:
            return one
    return min(whole, middle, key=lambda one: one.misfit)


def make_identification_settings(config: DiagnoseConfig) -> IdentificationSettings:
    """How a sim is fitted to its own recordings."""
    ridge, iterations = config.identify_ridge, config.identify_iterations
    return IdentificationSettings(config.steps_per_period, ridge, iterations, FIT_TOLERANCE)


def move_rest_to_minimum(model: MechanicalModel, q: Float64[np.ndarray, "N d"]) -> MechanicalModel:
    """The model at rest where its potential is lowest along the motion, if its rest is unstable."""
    if np.linalg.eigvalsh(model.stiffness).min() > 0.0:
        return model
    return replace(
        model,
        rest=q[int(np.argmin(model.basis.first(len(model.potential)).values(q) @ model.potential))].copy(),
    )
