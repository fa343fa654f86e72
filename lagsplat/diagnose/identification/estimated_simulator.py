"""A simulator that is known from its recordings alone: its model, its misfit and its uncertainty."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.core.config import IDENTIFICATION, NOVELTY, DiagnoseConfig
from lagsplat.diagnose.data_quality.natural_period import estimate_spectral_period_s
from lagsplat.diagnose.estimation import dataset
from lagsplat.diagnose.identification.novelty import KnownRegion, NoveltyDetector, drop_outlier_windows
from lagsplat.diagnose.identification.structure_search import (
    IdentificationProblem,
    IdentifiedModel,
    InformationCriterion,
    build_identification_problem,
    identify_model,
    refit_model,
)
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.mechanics.structure import flatten_coefficients
from lagsplat.io.trajectory.trajectory import Trajectory


@dataclass(frozen=True)
class EstimatedSimulator:
    """A simulator's model and what is uncertain about it."""

    model: MechanicalModel
    uncertainty_directions: Float64[np.ndarray, "R K"]  # changes of all coefficients by a standard deviation
    misfit: float  # mean square residual on its own recordings, in units of their noise
    correlation: float = 1.0  # samples of that residual that count as one independent sample
    own_error: Float64[np.ndarray, " d"] | float = 0.0
    """Mean square error of its forecasts of its own recordings, beyond the noise [coordinate^2]."""
    window_scale: float = 1.0  # length of the windows that it can predict, as a share of that in the settings
    original: "EstimatedSimulator | None" = None  # before its coefficients were recalibrated, if they were
    novelty_detector: NoveltyDetector | None = None  # where windows unlike its own are to be left out
    known_region: KnownRegion | None = None  # outside of which its law is not to be trusted
    outlier_spans: tuple[dataset.FileSpan, ...] = ()
    """Parts of its own recordings that were left out, because no law fits them together with the rest."""
    criterion: InformationCriterion | None = None  # of the model, if it was identified

    @classmethod
    def exact(cls, model: MechanicalModel) -> "EstimatedSimulator":
        """A simulator whose model is given, so that nothing about it is uncertain."""
        return cls(model, np.zeros((0, flatten_coefficients(model).size)), 1.0)


def estimate_simulator(motions: Sequence[Trajectory], config: DiagnoseConfig) -> EstimatedSimulator:
    """Identify the simulator that made these recordings.

    Where its rollouts cannot follow windows of the usual length, shorter ones are tried.

    Raises:
        ValueError: nothing moves, or no clip is long enough for a window.
    """
    period_s = estimate_spectral_period_s(motions)
    ready = dataset.prepare_dataset(motions, period_s=period_s)

    def pose(windows: dataset.WindowSet) -> IdentificationProblem:
        return build_identification_problem(ready, windows, config, period_s=period_s)

    def identify(windows: dataset.WindowSet) -> IdentifiedModel:
        return identify_model(pose(windows), period_s=period_s)

    def refit(identified: IdentifiedModel, windows: dataset.WindowSet) -> IdentifiedModel:
        return refit_model(pose(windows), identified)

    def fit_windows(scale: float, without: tuple[dataset.FileSpan, ...] = ()) -> EstimatedSimulator:
        length_s = scale * config.window_periods * period_s
        min_frames = IDENTIFICATION.min_window_frames
        windows = dataset.cut_windows(ready.dataset, length_s=length_s, min_frames=min_frames)
        kept = dataset.drop_overlapping_windows(windows, ready.dataset, without)
        if len(kept.first) >= NOVELTY.min_windows:
            windows = kept
        identified, outliers = drop_outlier_windows(identify(windows), refit, identify)
        model = move_rest_to_minimum(identified.model, ready.dataset.smooth)
        return EstimatedSimulator(
            model,
            identified.uncertainty_directions,
            identified.misfit * _compare_noise(ready, identified, period_s),
            correlation=identified.criterion.correlation,
            window_scale=scale,
            outlier_spans=(*without, *dataset.locate_windows(outliers, ready.dataset)),
            criterion=identified.criterion,
        )

    usual = fit_windows(1.0)
    if usual.misfit < IDENTIFICATION.diverged_misfit:
        return usual
    middle_scale, short_scale = IDENTIFICATION.window_scales
    short = fit_windows(short_scale)  # the shortest windows show best where an outlier lies
    middle = fit_windows(middle_scale, short.outlier_spans)
    for candidate in (middle, short):
        if candidate.misfit < NOVELTY.poor_misfit:
            return candidate
    return min(usual, middle, key=lambda candidate: candidate.misfit)


def _compare_noise(ready: dataset.PreparedDataset, identified: IdentifiedModel, period_s: float) -> float:
    """Misfit by the noise that the identified model leaves, where it is larger, over the misfit so far."""
    residual = identified.fit.residual
    found = dataset.measure_window_noise(
        ready.dataset, identified.windows, residual * ready.sigma, period_s=period_s
    )
    smaller = residual * ready.sigma / np.maximum(ready.sigma, found)
    return float(np.sum(smaller**2)) / max(float(np.sum(residual**2)), np.finfo(float).tiny)


def move_rest_to_minimum(model: MechanicalModel, q: Float64[np.ndarray, "N d"]) -> MechanicalModel:
    """The model with an unstable rest moved to where the potential is lowest along the motion ``q``."""
    if np.linalg.eigvalsh(model.stiffness).min() > 0.0:
        return model
    potential = model.basis.values(q)[:, : len(model.potential)] @ model.potential
    return replace(model, rest=q[int(np.argmin(potential))].copy())
