"""Fits a law of polynomial terms: weak form, then maximum likelihood with priors that the evidence sets.

The start has the degrees with which the weak form forecasts parts of the clip best that were withheld from
it. Then come a map into the coordinates of the law, since an encoder that bends the coordinates bends every
term of the law alike, the energies, and the frame of mass and damping. Which of them there are, and how large
each may be, is set by the evidence, see `lagsplat.stage2.likelihood.prior`. Where a linear law forecasts as
well as the result, it is kept: what a chart gets wrong repeats itself and counts as evidence for terms that
no mechanism has, but does not help to forecast.
"""

import copy
import math
from collections.abc import Sequence
from contextlib import suppress
from dataclasses import replace

import numpy as np
from jaxtyping import Float64

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2.config import LikelihoodConfig
from lagsplat.stage2.finished_fits import Recall, solve_anew
from lagsplat.stage2.likelihood.fitted_law import (
    FIRST_COUPLING,
    FittedLaw,
    change_degrees,
    drop_absent_terms,
    is_mechanism,
    set_time_scales,
)
from lagsplat.stage2.likelihood.multiple_shooting import MultipleShooting, fit_windows
from lagsplat.stage2.likelihood.parameter_vector import FRAME, POTENTIAL, ParameterVector
from lagsplat.stage2.likelihood.prior import ABSENT
from lagsplat.stage2.likelihood.uncertainty import draw_parameters, leave_out_windows
from lagsplat.stage2.likelihood.weak_form_fit import LINEAR, WeakFormFit
from lagsplat.stage2.likelihood.window_likelihood import WindowFit
from lagsplat.stage2.likelihood.windows import choose_stretches

# The numbers below were set by hand, with both simulated arms, the rocker and the chair in view.
FIRST_LEGS = ((0.2, 0.3), (0.2, 0.3), (0.5, 0.3), (1.0, FIRST_COUPLING))
"""Length of the windows, as a share of the final one, and their coupling: they forgive a poor start."""
FIRST_SHARE = 0.01
"""Of the misfit, by which each of their steps must lower it: fitted to the end, free windows overfit."""
COUPLED_LEGS = ((1.0, FIRST_COUPLING), (1.0, 0.03), (1.0, 0.01), (1.0, 0.003), (1.0, 0.001))
"""The same, until the motion follows the law alone."""
LEAST_GAIN = 0.5  # of a step [nat]: fits end after smaller ones
FEWEST_PERIODS = 40  # of the slowest mode, which a part of the frames holds
INDIFFERENT = 2.0  # a difference of evidence that says nothing [nat]
MEAN_STATE = 1.0  # score of a forecast that is always the mean state of the clip


class LikelihoodFit:
    """A fit of polynomial laws to one recording.

    Args:
        weak_form: laws to start from, and the trajectory as encoded.
        smooth: the trajectory, smoothed, from which windows take their first states.
        settings: of the likelihood.
        recall: of fits of windows in an earlier process.
    """

    def __init__(
        self,
        weak_form: WeakFormFit,
        smooth: EncodedTrajectory,
        settings: LikelihoodConfig,
        *,
        recall: Recall = solve_anew,
    ) -> None:
        self.recall = recall
        self.weak_form, self.measured, self.settings = weak_form, weak_form.measured, settings
        self.smooth = replace(smooth, inputs=self.measured.inputs)
        self.form, self.seed = weak_form.form, weak_form.seed

    def draw_laws(self, fitted: FittedLaw) -> Float64[np.ndarray, "n p"]:
        """Draw parameters of laws that the recording allows as well.

        Raises:
            ValueError: the recording is too short to be divided.
            numpy.linalg.LinAlgError: a parameter is not determined.
        """
        theta = ParameterVector(fitted.law).read().numpy()
        if fitted.half_width is not None:
            return draw_parameters(theta, self.weak_form.leave_out_frames(fitted), seed=self.seed)
        problem, windows = self.solve_windows(fitted)
        scores = problem.score_windows(windows)
        left_out = theta + leave_out_windows(scores)
        return draw_parameters(theta, left_out, information=scores.information, seed=self.seed)

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
                f"no polynomial law of degree 2 to {self.form.degrees.potential} forecasts the training clip "
                f"better than its mean state (error {chosen.errors.score:.3g} of its rms): the latents may "
                "be too noisy, or no coordinates of a mechanism. Look at reconstruction.png and latent.png, "
                "or take stage2=paper, which is trained on single steps"
            )
        return chosen

    def _prefer_linear_law(self, fitted: FittedLaw) -> FittedLaw:
        """The linear law if it forecasts as well, of the latents or where they answer inputs linearly.

        It is fitted by likelihood where its evidence is that of the richer law, and otherwise stays the one
        of the weak form: a motion whose frequency depends on its amplitude gets out of phase with a linear
        law, which the likelihood takes for damping.
        """
        linear = self.weak_form.choose_linear_law()
        if not linear.errors.is_as_good_as(fitted.errors):
            return fitted
        if linear.law.form.degrees == LINEAR and fitted.relevance is not None:
            comparable = replace(linear, noise=fitted.noise, memory=fitted.memory)
            likely = self._fit(comparable, 1.0, fitted.coupling, part=1)
            if likely.evidence > fitted.evidence - INDIFFERENT and is_mechanism(likely.law):
                return likely
        return self._measure_residual_noise(linear)

    def _climb(self, start: FittedLaw) -> FittedLaw:
        """Fit a start with all terms, whose priors the evidence tells.

        Springs that are not linear, and the frame of mass and damping, are absent until the evidence asks for
        them. They give a motion its harmonics, as the map does. A motion of nearly one amplitude does not
        tell them apart, and with them the frequency depends on the amplitude.
        """
        loose, safe = self._estimate_noise(start)
        full = change_degrees(loose.law, self.form.degrees, seed=self.seed)
        groups = ParameterVector(full).list_groups()
        relevance = np.array([ABSENT if name in (FRAME, POTENTIAL) else 1.0 for name in groups])
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
            if not now.evidence > before - INDIFFERENT or not is_mechanism(now.law):
                break
            if now.evidence > reached - INDIFFERENT and not now.errors.is_worse_than(start.errors):
                accepted, reached = now, now.evidence
            elif accepted is not start:
                break
            # else: a richer law may forecast well only once its windows are coupled closer than they like
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
        set_time_scales(law, self.measured, period_frames=self.weak_form.period_frames)
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
            recall=self.recall,
        )
        evidence = -math.inf
        if fitted.missed < MEAN_STATE:
            with suppress(np.linalg.LinAlgError):  # a start that nothing determines
                evidence = problem.measure_evidence(fitted)
        errors = self.weak_form.measure("likelihood", law, fitted.steps, fitted.cost)
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
