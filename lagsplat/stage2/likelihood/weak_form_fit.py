"""Laws of the weak form of one recording, among which forecasts choose.

The start of a fit has the degrees with which the weak form forecasts parts of the clip best that were
withheld from it. A linear law is linear in the latents, or where they answer the inputs linearly.
"""

from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2.config import Degrees, FormConfig
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.stage2.likelihood.fitted_law import LEAST_NOISE, FittedLaw, set_time_scales
from lagsplat.stage2.likelihood.parameter_vector import ParameterVector
from lagsplat.stage2.likelihood.response_map import fit_response_map
from lagsplat.stage2.likelihood.uncertainty import BLOCKS
from lagsplat.stage2.polynomials import PolynomialMap
from lagsplat.stage2.validation import ForecastErrors
from lagsplat.stage2.weak_form import fit_weak_form

# The numbers below were set by hand, with both simulated arms, the rocker and the chair in view.
BUMP_SHARES = (0.2, 0.4, 0.7)  # half widths of the bumps of the weak form, in periods of the motion
FOLDS = 4  # parts of the clip that are withheld in turn from the start
MOST_OF_ONE = Degrees(potential=8, inputs=3, coordinates=4, matrices=2)  # for one coordinate
MOST_OF_SEVERAL = Degrees(potential=4, inputs=3, coordinates=2, matrices=1)
MAP_OF_INPUTS = 4  # largest degree of a map into coordinates that answer the inputs linearly
LINEAR = Degrees(potential=2, inputs=1, coordinates=1, matrices=0)


class WeakFormFit:
    """Fits of the weak form to one recording.

    Args:
        measured: the trajectory as encoded.
        smooth: the same, smoothed: what is removed is the first guess of the noise.
        form: of the laws; a degree of None is the highest that is usual.
        time_unit_s: internal unit of time of the laws [s].
        period_frames: a first guess of the slowest period.
        seed: of laws, which have no random weights.
        measure: errors of a law's forecasts, called with the stage, the law, the steps and the misfit.
        validate: the same errors, of a law that is not reported.
    """

    def __init__(
        self,
        measured: EncodedTrajectory,
        smooth: EncodedTrajectory,
        form: FormConfig,
        *,
        time_unit_s: float,
        period_frames: int,
        seed: int,
        measure: Callable[[str, Lagrangian, int, float], ForecastErrors],
        validate: Callable[[Lagrangian], ForecastErrors],
    ) -> None:
        # in several coordinates polynomials of high degree are free wherever the recording is thin
        most = MOST_OF_ONE if measured.latents.shape[1] == 1 else MOST_OF_SEVERAL
        degrees = Degrees(
            most.potential if form.potential_degree is None else form.potential_degree,
            form.input_degree if measured.inputs.shape[1] else 1,
            most.coordinates if form.map_degree is None else form.map_degree,
            most.matrices if form.matrix_degree is None else form.matrix_degree,
        )
        self.measured, self.form = measured, replace(form, terms="polynomial").with_degrees(degrees)
        self.highest_map = MAP_OF_INPUTS if form.map_degree is None else form.map_degree
        self.noise = np.maximum((measured.latents - smooth.latents).std(axis=0), LEAST_NOISE)
        self.time_unit_s, self.period_frames, self.seed = time_unit_s, period_frames, seed
        self.measure, self.validate = measure, validate

    def choose_start(self) -> FittedLaw:
        """The simplest law of the weak form that forecasts as well as the best, with bumps of several widths.

        What counts are forecasts of frames that were withheld from it, in a cross-validation.

        Raises:
            ValueError: no segment is as long as a bump.
        """
        starts, withheld = [], []
        for degrees in reversed(list_lower_degrees(self.form.degrees._replace(coordinates=1, matrices=0))):
            start = self._choose_width(degrees)
            starts.append(start)
            withheld.append(self._cross_validate(start))
        best = min(withheld, key=lambda errors: errors.score)
        return next(
            start for start, errors in zip(starts, withheld, strict=True) if not errors.is_worse_than(best)
        )

    def choose_linear_law(self) -> FittedLaw:
        """The linear law that forecasts best, of the latents or where they answer inputs linearly."""
        laws = [self._choose_width(LINEAR)]
        for degree in range(2, self.highest_map + 1):
            coordinates = fit_response_map(self.measured, degree=degree)
            if coordinates is not None:
                laws.append(self._choose_width(LINEAR._replace(coordinates=degree), coordinates))
        return min(laws, key=lambda each: each.errors.score)

    def leave_out_frames(self, fitted: FittedLaw) -> Float64[np.ndarray, "n p"]:
        """Parameters of a law of the weak form, fitted again without one of `BLOCKS` blocks of frames each.

        Raises:
            ValueError: what is left is shorter than a bump.
        """
        trajectory = self._straighten(fitted.law.coordinates)
        assert fitted.half_width is not None
        left_out = []
        for block in self._cut(BLOCKS):
            part, degrees = leave_out(trajectory, *block), fitted.law.form.degrees
            law = self._fit(part, degrees, fitted.half_width, fitted.law.coordinates)
            left_out.append(ParameterVector(law).read().numpy())
        return np.stack(left_out)

    def _straighten(self, coordinates: PolynomialMap | None) -> EncodedTrajectory:
        """The trajectory as encoded, in other ``coordinates`` if given."""
        if coordinates is None:
            return self.measured
        with torch.no_grad():
            straight, _ = coordinates.evaluate(torch.from_numpy(self.measured.latents))
        return replace(self.measured, latents=straight.numpy())

    def _choose_width(self, degrees: Degrees, coordinates: PolynomialMap | None = None) -> FittedLaw:
        """The law of the bumps whose width forecasts best; in other ``coordinates`` if given."""
        trajectory = self._straighten(coordinates)
        longest = max(stop - start for start, stop in trajectory.segments)
        widths = {max(3, round(share * self.period_frames)) for share in BUMP_SHARES}
        fitting = sorted(width for width in widths if 4 * width < longest) or [min(widths)]
        of_widths = []
        for width in fitting:
            law = self._fit(trajectory, degrees, width, coordinates)
            period = set_time_scales(law, self.measured, period_frames=self.period_frames)
            errors = self.measure("start", law, width, float("nan"))
            memory = np.zeros_like(self.noise)
            of_widths.append(FittedLaw(law, errors, period, self.noise, memory, half_width=width))
        return min(of_widths, key=lambda each: each.errors.score)

    def _fit(
        self,
        trajectory: EncodedTrajectory,
        degrees: Degrees,
        width: int,
        coordinates: PolynomialMap | None = None,
    ) -> Lagrangian:
        """The law of a trajectory in ``coordinates``, into which it maps the latents."""
        law = fit_weak_form(
            trajectory,
            self.form.with_degrees(degrees),
            half_width=width,
            time_unit_s=self.time_unit_s,
            seed=self.seed,
        )
        if law.coordinates is not None and coordinates is not None:
            law.coordinates.load_state_dict(coordinates.state_dict())
        return law

    def _cross_validate(self, start: FittedLaw) -> ForecastErrors:
        """Errors in each fold of laws fitted to the others; of the law itself where these are too short."""
        assert start.half_width is not None
        parts = []
        for fold in self._cut(FOLDS):
            try:
                law = self._fit(leave_out(self.measured, *fold), start.law.form.degrees, start.half_width)
            except ValueError:
                return start.errors
            law.longest_step = start.law.longest_step
            errors = self.validate(law)
            inside = errors.of_frames(*fold)
            if inside is not errors:  # a rollout begins in this fold
                parts.append(inside)
        return ForecastErrors.join(parts)

    def _cut(self, count: int) -> list[tuple[int, int]]:
        """Ends of as many parts of the clip of equal length."""
        ends = np.linspace(0, len(self.measured.latents), count + 1).round().astype(int).tolist()
        return list(pairwise(ends))


def leave_out(trajectory: EncodedTrajectory, start: int, stop: int) -> EncodedTrajectory:
    """The trajectory with segments that end before a frame, or begin at another."""
    parts = [part for a, b in trajectory.segments for part in ((a, min(b, start)), (max(a, stop), b))]
    return replace(trajectory, segments=tuple((a, b) for a, b in parts if b - a > 1))


def list_lower_degrees(degrees: Degrees) -> list[Degrees]:
    """The degrees and lower ones down to a linear law, each one degree below the one before.

    The degree of the inputs is lowered first, then that of the potential, and so on.
    """
    ladder = [degrees]
    while (ladder[-1].potential, ladder[-1].inputs) != (2, 1):
        potential, inputs = ladder[-1].potential, ladder[-1].inputs
        if inputs > 1 and (inputs >= potential - 1 or potential == 2):
            ladder.append(ladder[-1]._replace(inputs=inputs - 1))
        else:
            ladder.append(ladder[-1]._replace(potential=potential - 1))
    return ladder
