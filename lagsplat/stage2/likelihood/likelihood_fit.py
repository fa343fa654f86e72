"""Fits a law of polynomial terms: weak form, then maximum likelihood with priors that the evidence sets.

The start has the degrees with which the weak form forecasts parts of the clip best that were withheld from
it. Then all terms are fitted together: a map into the coordinates of the law, since an encoder that bends the
coordinates bends every term of the law alike; the energies; and the frame of mass and damping. How large each
may be is set by the evidence, see `lagsplat.stage2.likelihood.prior`. Where a linear law forecasts as well as
the result, it is kept: what a chart gets wrong repeats itself and counts as evidence for terms that no
mechanism has, but does not help to forecast.
"""

import copy
import math
from collections.abc import Callable, Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from itertools import pairwise

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2.config import Degrees, Stage2Config
from lagsplat.stage2.lagrangian import Coefficients, Lagrangian, linearize_modes
from lagsplat.stage2.likelihood.multiple_shooting import MultipleShooting, fit_windows
from lagsplat.stage2.likelihood.parameter_vector import FRAME, MAP, POTENTIAL, VOLUMES, ParameterVector
from lagsplat.stage2.likelihood.prior import ABSENT
from lagsplat.stage2.likelihood.response_map import fit_response_map
from lagsplat.stage2.likelihood.uncertainty import BLOCKS, draw_parameters, leave_out_windows
from lagsplat.stage2.likelihood.window_likelihood import WindowFit
from lagsplat.stage2.likelihood.windows import choose_stretches
from lagsplat.stage2.polynomials import PolynomialMap
from lagsplat.stage2.validation import ForecastErrors
from lagsplat.stage2.weak_form import fit_weak_form

# The numbers below were set by hand, with both simulated arms, the rocker and the chair in view.
MOST_OF_ONE = Degrees(potential=8, inputs=3, coordinates=4, matrices=2)  # for one coordinate
MOST_OF_SEVERAL = Degrees(potential=4, inputs=3, coordinates=2, matrices=1)
FIRST_LEGS = ((0.2, 0.3), (0.2, 0.3), (0.5, 0.3), (1.0, 0.1))
"""Length of the windows, as a share of the final one, and their coupling: they forgive a poor start."""
FIRST_SHARE = 0.01
"""Of the misfit, by which each of their steps must lower it: fitted to the end, free windows overfit."""
COUPLED_LEGS = ((1.0, 0.1), (1.0, 0.03), (1.0, 0.01), (1.0, 0.003), (1.0, 0.001))
"""The same, until the motion follows the law alone."""
LEAST_GAIN = 0.5  # of a step [nat]: fits end after smaller ones
FEWEST_PERIODS = 40  # of the slowest mode, which a part of the frames holds
INDIFFERENT = 2.0  # a difference of evidence that says nothing [nat]
LINEAR = Degrees(potential=2, inputs=1, coordinates=1, matrices=0)
MAP_OF_INPUTS = 4  # largest degree of a map into coordinates that answer the inputs linearly
BUMP_SHARES = (0.2, 0.4, 0.7)  # half widths of the bumps of the weak form, in periods of the motion
LEAST_NOISE = 1e-4  # of encoded positions [whitened units]
LARGEST_STEP = 1.2  # times the fastest eigenvalue of a Runge-Kutta step: its error is 2 %, and it is stable
ACCURATE_STEP = 0.6  # times the slowest one: 0.1 %
MOST_PIECES = 4  # of a frame
FOLDS = 4  # parts of the clip that are withheld in turn from the start
MEAN_STATE = 1.0  # score of a forecast that is always the mean state of the clip


@dataclass(frozen=True)
class FittedLaw:
    """A law, how well it forecasts and explains the recording, under which noise and coupling."""

    law: Lagrangian
    errors: ForecastErrors  # over the training clip
    period_frames: int  # of its slowest oscillation
    noise: Float64[np.ndarray, " d"]  # of encoded positions [whitened units]
    memory: Float64[np.ndarray, " d"]  # its correlation from frame to frame
    coupling: float = COUPLED_LEGS[0][1]
    evidence: float = -math.inf  # [nat]
    relevance: Float64[np.ndarray, " g"] | None = None  # of the priors of terms that a linear law has not
    solved: tuple[MultipleShooting, WindowFit] | None = None  # None: its windows are not fitted
    half_width: int | None = None  # of the bumps [frames], if it is a law of the weak form

    def with_fitted_noise(self) -> "FittedLaw":
        """Take what the law leaves of the encoded positions for their noise, under which evidence is open."""
        if self.solved is None:
            return self
        fitted = self.solved[1]
        noise = np.maximum(fitted.rms, LEAST_NOISE)
        return replace(self, noise=noise, memory=fitted.memory, evidence=-math.inf)


class LikelihoodFit:
    """A fit of polynomial laws to one recording.

    Args:
        measured: the trajectory as encoded.
        smooth: the same, smoothed, from which windows take their first states.
        config: of stage 2.
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
        config: Stage2Config,
        *,
        time_unit_s: float,
        period_frames: int,
        seed: int,
        measure: Callable[[str, Lagrangian, int, float], ForecastErrors],
        validate: Callable[[Lagrangian], ForecastErrors],
    ) -> None:
        self.measured, self.smooth = measured, replace(smooth, inputs=measured.inputs)
        self.settings, self.time_unit_s = config.likelihood, time_unit_s
        self.seed, self.measure, self.validate = seed, measure, validate
        self.period_frames = period_frames
        ends = np.linspace(0, len(measured.latents), FOLDS + 1).round().astype(int).tolist()
        self.folds = list(pairwise(ends))
        # in several coordinates polynomials of high degree are free wherever the recording is thin
        form, most = config.form, MOST_OF_ONE if measured.latents.shape[1] == 1 else MOST_OF_SEVERAL
        self.most = Degrees(
            most.potential if form.potential_degree is None else form.potential_degree,
            form.input_degree if measured.inputs.shape[1] else 1,
            most.coordinates if form.map_degree is None else form.map_degree,
            most.matrices if form.matrix_degree is None else form.matrix_degree,
        )
        self.form = replace(form, terms="polynomial").with_degrees(self.most)
        self.map_degree = form.map_degree
        self.ladder = list_lower_degrees(self.most._replace(coordinates=1, matrices=0))

    def choose_start(self) -> FittedLaw:
        """The simplest law of the weak form that forecasts as well as the best, with bumps of several widths.

        What counts are forecasts of frames that were withheld from it, in a cross-validation.

        Raises:
            ValueError: no segment is as long as a bump.
        """
        starts, withheld = [], []
        for degrees in reversed(self.ladder):
            start = self._choose_width(degrees)
            starts.append(start)
            withheld.append(self._cross_validate(start))
        best = min(withheld, key=lambda errors: errors.score)
        return next(
            start for start, errors in zip(starts, withheld, strict=True) if not errors.is_worse_than(best)
        )

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
        noise = np.maximum((self.measured.latents - self.smooth.latents).std(axis=0), LEAST_NOISE)
        of_widths = []
        for width in fitting:
            law = self._fit_weak_form(trajectory, degrees, width, coordinates)
            period = self._set_time_scales(law)
            errors = self.measure("start", law, width, float("nan"))
            of_widths.append(FittedLaw(law, errors, period, noise, np.zeros_like(noise), half_width=width))
        return min(of_widths, key=lambda each: each.errors.score)

    def _fit_weak_form(
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
        for fold in self.folds:
            try:
                law = self._fit_weak_form(
                    leave_out(self.measured, *fold), start.law.form.degrees, start.half_width
                )
            except ValueError:
                return start.errors
            law.longest_step = start.law.longest_step
            errors = self.validate(law)
            inside = errors.of_frames(*fold)
            if inside is not errors:  # a rollout begins in this fold
                parts.append(inside)
        return ForecastErrors.join(parts)

    def draw_laws(self, fitted: FittedLaw) -> Float64[np.ndarray, "n p"]:
        """Draw parameters of laws that the recording allows as well.

        Raises:
            ValueError: the recording is too short to be divided.
            numpy.linalg.LinAlgError: a parameter is not determined.
        """
        theta = ParameterVector(fitted.law).read().numpy()
        if fitted.half_width is not None:
            return draw_parameters(theta, self._leave_out_frames(fitted), seed=self.seed)
        problem, windows = self.solve_windows(fitted)
        scores = problem.score_windows(windows)
        left_out = theta + leave_out_windows(scores)
        return draw_parameters(theta, left_out, information=scores.information, seed=self.seed)

    def _leave_out_frames(self, fitted: FittedLaw) -> Float64[np.ndarray, "n p"]:
        """Parameters of laws of the weak form as the given one, each without a block of the frames."""
        trajectory = self._straighten(fitted.law.coordinates)
        ends = np.linspace(0, len(trajectory.latents), BLOCKS + 1).round().astype(int).tolist()
        assert fitted.half_width is not None
        left_out = []
        for block in pairwise(ends):
            part, degrees = leave_out(trajectory, *block), fitted.law.form.degrees
            law = self._fit_weak_form(part, degrees, fitted.half_width, fitted.law.coordinates)
            left_out.append(ParameterVector(law).read().numpy())
        return np.stack(left_out)

    def solve_windows(self, fitted: FittedLaw) -> tuple[MultipleShooting, WindowFit]:
        """The windows of a law and their starts; those of a law of the weak form are fitted to it."""
        solved = fitted.solved or self._fit(fitted, 1.0, fitted.coupling, part=1, hold_law=True).solved
        assert solved is not None
        return solved

    def maximize(self, start: FittedLaw) -> FittedLaw:
        """Fit a law in a part of the frames, and then in all.

        Raises:
            ValueError: no law forecasts the clip better than its mean state does.
        """
        climbed = self._climb(start)
        chosen = self._tighten(climbed.with_fitted_noise(), self._list_legs(climbed.coupling), part=1)
        if chosen.relevance is not None and ABSENT in chosen.relevance:
            chosen = self._fit(drop_absent_terms(chosen, seed=self.seed), 1.0, chosen.coupling, part=1)
        chosen = self._prefer_linear_law(chosen)
        if not chosen.errors.score < MEAN_STATE:
            raise ValueError(
                f"no polynomial law of degree 2 to {self.most.potential} forecasts the training clip "
                f"better than its mean state (error {chosen.errors.score:.3g} of its rms): the latents may "
                "be too noisy, or no coordinates of a mechanism. Look at reconstruction.png and latent.png, "
                "or take stage2=paper, which is trained on single steps"
            )
        return chosen

    def _prefer_linear_law(self, fitted: FittedLaw) -> FittedLaw:
        """The linear law if it forecasts as well, of the latents or where they answer inputs linearly."""
        highest = MAP_OF_INPUTS if self.map_degree is None else self.map_degree
        laws = [self._choose_width(LINEAR)]
        for degree in range(2, highest + 1):
            coordinates = fit_response_map(self.measured, degree=degree)
            if coordinates is not None:
                laws.append(self._choose_width(LINEAR._replace(coordinates=degree), coordinates))
        linear = min(laws, key=lambda each: each.errors.score)
        if not linear.errors.is_as_good_as(fitted.errors):
            return fitted
        held = self._measure_residual_noise(linear)
        if linear.law.form.degrees.coordinates > 1:
            return held
        likely = held
        for _ in range(2):  # the second time under the noise that the most likely law leaves
            likely = self._fit(likely.with_fitted_noise(), 1.0, fitted.coupling, part=1)
        worse = likely.errors.is_worse_than(held.errors) or not _is_mechanism(likely.law)
        return held if worse else likely

    def _climb(self, start: FittedLaw) -> FittedLaw:
        """Fit a start with all terms, whose priors the evidence tells."""
        loose, safe = self._estimate_noise(start)
        full = change_degrees(loose.law, self.most, seed=self.seed)
        relevance = np.ones(len(ParameterVector(full).list_groups()))
        now = self._tighten(replace(loose, law=full, relevance=relevance), COUPLED_LEGS, part=2)
        if now.law is full:
            return safe
        return self._tighten(now.with_fitted_noise(), self._list_legs(now.coupling), part=2)

    def _estimate_noise(self, start: FittedLaw) -> tuple[FittedLaw, FittedLaw]:
        """Fit loose windows, whose residuals become the noise; the law after them, and the best forecast."""
        now = best = start
        for share, coupling in FIRST_LEGS:
            fitted = self._fit(now, share, coupling, part=4, least_share=FIRST_SHARE)
            if fitted.solved is None or not fitted.solved[1].steps:
                now = replace(best, noise=now.noise, memory=now.memory)
                continue
            now = fitted.with_fitted_noise()
            best = min(best, now, key=lambda each: each.errors.score)
        if now.errors.is_worse_than(best.errors):
            now = best = self._estimate_residual_noise(replace(best, noise=start.noise, memory=start.memory))
        loose = replace(now, coupling=COUPLED_LEGS[0][1])
        safe = replace(best, noise=now.noise, memory=now.memory, evidence=-math.inf)
        return replace(loose, errors=best.errors), safe

    def _estimate_residual_noise(self, good: FittedLaw) -> FittedLaw:
        """Take for noise what a law that forecasts well leaves, and fit it once under that.

        In loose windows a law may follow some coordinates to the last digit and give up the others, whose
        residuals then count for noise. What a good law leaves of each keeps them in balance.
        """
        held, (share, coupling) = self._measure_residual_noise(good), COUPLED_LEGS[0]
        fitted = self._fit(held, share, coupling, part=2, least_share=FIRST_SHARE)
        return held if fitted.errors.is_worse_than(good.errors) else fitted.with_fitted_noise()

    def _measure_residual_noise(self, good: FittedLaw) -> FittedLaw:
        """Take for noise what a law leaves."""
        share, coupling = COUPLED_LEGS[0]
        held = self._fit(good, share, coupling, part=2, least_share=FIRST_SHARE, hold_law=True)
        held = held.with_fitted_noise()
        return replace(held, law=good.law, errors=good.errors, solved=None)

    def _tighten(self, start: FittedLaw, legs: Sequence[tuple[float, float]], *, part: int) -> FittedLaw:
        """Couple the windows ever closer, as long as the evidence allows it.

        What the law does not explain is so taken for noise of the encoder, as long as it can be that.
        Evidences are compared under the same noise and frames alone, one ``part`` in so many of all.
        """
        accepted, reached = start, start.evidence
        now = replace(start, evidence=-math.inf)
        for share, coupling in legs:
            now, before = self._fit(now, share, coupling, part=part), now.evidence
            if not now.evidence > before - INDIFFERENT or not _is_mechanism(now.law):
                break
            # a richer law may forecast well only once its windows are coupled closer than they like
            if now.evidence > reached - INDIFFERENT and not now.errors.is_worse_than(start.errors):
                accepted, reached = now, now.evidence
        return accepted

    def _list_legs(self, coupling: float) -> Sequence[tuple[float, float]]:
        """Legs from one that is looser on: such windows let go of what a law has made of the motion."""
        looser = sum(each > coupling for _, each in COUPLED_LEGS) - 1
        return COUPLED_LEGS[max(0, looser) :]

    def _fit(
        self,
        start: FittedLaw,
        share: float,
        coupling: float,
        *,
        part: int,
        least_share: float = 0.0,
        hold_law: bool = False,
    ) -> FittedLaw:
        """Fit windows of a ``share`` of the final length, in one ``part`` of the frames in so many."""
        frames = max(self.settings.frames // part, FEWEST_PERIODS * start.period_frames)
        segments = choose_stretches(self.measured.segments, frames=frames)
        n = round(share * self.settings.periods * start.period_frames)
        longest = max(stop - begin for begin, stop in segments) - 1
        law = copy.deepcopy(start.law)
        self._set_time_scales(law)
        problem, fitted = fit_windows(
            law,
            self.measured,
            self.smooth,
            segments,
            n=int(np.clip(n, min(4, longest), longest)),
            coupling=coupling,
            noise=start.noise,
            memory=start.memory,
            iterations=self.settings.iterations,
            least_gain=LEAST_GAIN,
            least_share=least_share,
            hold_law=hold_law,
            least_growth=None if start.relevance is None or hold_law else INDIFFERENT,
            relevance=start.relevance,
            near=start.solved,
        )
        evidence = -math.inf
        if fitted.missed < MEAN_STATE:
            with suppress(np.linalg.LinAlgError):  # a start that nothing determines
                evidence = problem.measure_evidence(fitted)
        errors = self.measure("likelihood", law, fitted.steps, fitted.cost)
        return replace(
            start,
            law=law,
            errors=errors,
            coupling=coupling,
            evidence=evidence,
            relevance=None if start.relevance is None else problem.prior.relevance,
            solved=(problem, fitted),
            half_width=start.half_width if hold_law else None,
        )

    def _set_time_scales(self, law: Lagrangian) -> int:
        """Let the fastest mode decide how many steps divide a frame; frames of the slowest period."""
        dt_s = self.measured.dt_s
        modes = linearize_modes(law, torch.from_numpy(self.measured.inputs.mean(0)))
        sizes = np.hypot(2.0 * np.pi * np.array(modes.frequency_hz), modes.decay_per_s) * dt_s
        pieces = math.ceil(max(sizes.max() / LARGEST_STEP, sizes.min() / ACCURATE_STEP))
        law.longest_step = dt_s / self.time_unit_s / int(np.clip(pieces, 1, MOST_PIECES))
        oscillating = [f for f in modes.frequency_hz if f > 0]
        return max(4, round(1.0 / (min(oscillating) * dt_s))) if oscillating else self.period_frames


def leave_out(trajectory: EncodedTrajectory, start: int, stop: int) -> EncodedTrajectory:
    """The trajectory with segments that end before a frame, or begin at another."""
    parts = [part for a, b in trajectory.segments for part in ((a, min(b, start)), (max(a, stop), b))]
    return replace(trajectory, segments=tuple((a, b) for a, b in parts if b - a > 1))


def _is_mechanism(law: Lagrangian) -> bool:
    """Whether its coordinates are one to one and a stable spring holds it far outside the data."""
    assert law.coordinates is not None
    assert law.energy is not None
    return law.coordinates.measure_least_stretch() > 0.0 and law.energy.measure_far_stiffness() > 0.0


def change_degrees(law: Lagrangian, degrees: Degrees, *, seed: int) -> Lagrangian:
    """Make a polynomial law of other degrees: the same function as ``law``, less the terms that it lacks."""
    eye = torch.eye(law.d, dtype=torch.float64)
    grown = Lagrangian(
        Coefficients(eye, eye, eye, eye.new_zeros(law.n_inputs, law.d), eye.new_zeros(law.d)),
        form=law.form.with_degrees(degrees),
        floors=law.floors,
        time_unit_s=float(law.time_unit_s),
        seed=seed,
        longest_step=law.longest_step,
    )
    state = grown.state_dict()
    for name, values in law.state_dict().items():
        # polynomials are in the order of degrees
        if name.startswith("energy.") and name.endswith("coefficients"):
            n = min(values.shape[-1], state[name].shape[-1])
            state[name].zero_()[..., :n] = values[..., :n]
        elif name.endswith(("frame.coefficients", "coordinates.coefficients")):
            n = min(len(values), len(state[name]))
            state[name].zero_()[:n] = values[:n]
        else:
            state[name] = values
    grown.load_state_dict(state)
    return grown


def drop_absent_terms(fitted: FittedLaw, *, seed: int) -> FittedLaw:
    """The same law without the terms that the evidence has taken out."""
    assert fitted.relevance is not None
    groups = ParameterVector(fitted.law).list_groups()
    absent = {name for name, each in zip(groups, fitted.relevance, strict=True) if each == ABSENT}
    now = fitted.law.form.degrees
    degrees = Degrees(
        potential=2 if POTENTIAL in absent else now.potential,
        inputs=1 if VOLUMES in absent else now.inputs,
        coordinates=1 if MAP in absent else now.coordinates,
        matrices=0 if FRAME in absent else now.matrices,
    )
    relevance = fitted.relevance[fitted.relevance != ABSENT]
    return replace(fitted, law=change_degrees(fitted.law, degrees, seed=seed), relevance=relevance)


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
