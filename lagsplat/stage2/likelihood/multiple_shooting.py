"""Maximum likelihood of a law by Gauss-Newton multiple shooting with variational equations.

Unknown are the parameters of the law and the state at the start of every window, in the coordinates of the
law. The coupling of the windows is tightened from fit to fit: loose windows converge from a poor law; coupled
ones do not let free starts absorb what the law gets wrong. The states are eliminated window by window, so
that a step solves one system of the size of the parameters. Steps are damped as Levenberg and Marquardt do.

Source: Bock 1983, "Recent advances in parameter identification techniques for O.D.E."; Marquardt 1963,
DOI 10.1137/0111030.
"""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import asdict, replace
from functools import partial
from typing import Any, NamedTuple

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.normal_equations import NormalEquations, eliminate_states, solve_normal
from lagsplat.stage2.finished_fits import Recall, Result, solve_anew
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.stage2.likelihood.guard import Guard
from lagsplat.stage2.likelihood.parameter_vector import ParameterVector, States
from lagsplat.stage2.likelihood.prior import make_prior
from lagsplat.stage2.likelihood.window_likelihood import Residuals, WindowFit, WindowLikelihood
from lagsplat.stage2.likelihood.windows import cut_windows

# The numbers below were set by hand, with both simulated arms, the rocker and the toy in view.
FIRST_DAMPING, LEAST_DAMPING = 1e-3, 1e-9
ATTEMPTS, STRENGTHENED, WEAKENED = 16, 4.0, 8.0  # of a step, and factors of its damping where it fails or not
SMALL_GAINS = 2  # in a row, after which a fit ends: one alone may be a bend of the valley
SETTLED = 0.2  # change of the logarithm of a prior's relevance, below which a fit may end
PROBE = 0.1  # share of a step for its curvature
MOST_TURN = 0.75  # largest second-order term (the source's)
MOST_MISSED = 3.0  # times the rms of the motion, from which a fit does not begin
CHUNK = 8  # windows whose derivatives are made at once
REGUARDED = 2  # times that a fit is repeated because its map came near a fold


class MultipleShooting(WindowLikelihood):
    """Fits a polynomial law by Gauss-Newton steps; see `WindowLikelihood` for its arguments."""

    parameters: ParameterVector

    def fit(
        self,
        starts: States,
        *,
        iterations: int,
        least_gain: float,
        least_share: float = 0.0,
        hold_law: bool = False,
        least_growth: float | None = None,
    ) -> WindowFit:
        """Take damped Gauss-Newton steps, and leave the law at the best parameters.

        It ends when the logarithm of the posterior density grows less than ``least_gain`` twice in a row, or
        once by less than ``least_share`` of the misfit. With ``hold_law`` the states at the window starts
        move alone.

        With ``least_growth`` the evidence sets the prior as well: its relevance follows the law, and where
        the fit would end, absent terms are added that raise the evidence by so much [nat].
        """
        theta, damping, steps, small = self.parameters.read(), FIRST_DAMPING, 0, 0
        now = self.evaluate(theta, starts)
        # slopes of windows that diverge lead nowhere
        lost = not self._missed(now) < MOST_MISSED
        for _ in range(0 if lost else iterations):
            slopes = self.differentiate(theta, now)
            normal = self.assemble(theta, now, slopes)
            changed = 0.0
            if steps and least_growth is not None:
                now, normal, changed = self._follow_prior(theta, now, normal)
            for _ in range(ATTEMPTS):
                with np.errstate(all="ignore"):  # a step that overflows is refused
                    step = self._step(theta, starts, now, slopes, normal, damping=damping, hold_law=hold_law)
                if step is not None:
                    after = self.evaluate(theta + step.law, starts + step.states)
                    if after.cost < now.cost:
                        break
                damping *= STRENGTHENED
            else:
                break
            gain = now.cost - after.cost
            small = small + 1 if gain < least_gain and changed < SETTLED else 0
            theta, starts, now = theta + step.law, starts + step.states, after
            damping, steps = max(damping / WEAKENED, LEAST_DAMPING), steps + 1
            if small == SMALL_GAINS or gain < least_share * now.cost:
                if least_growth is None or not self._add_terms(theta, now, least_growth):
                    break
                now, small, damping = self._with_prior(theta, now), 0, FIRST_DAMPING
        self.parameters.write(theta)
        return self.describe(now, starts, steps=steps)

    def fit_and_tell(self, starts: States, **settings: Any) -> Result:
        """Fit as `fit` does; all that it changes and returns, as plain data."""
        fitted = self.fit(starts, **settings)
        arrays = {"rms": fitted.rms, "memory": fitted.memory, "relevance": self.prior.relevance}
        return {
            **asdict(fitted),
            **{name: torch.from_numpy(array) for name, array in arrays.items()},
            "law": self.parameters.read(),
        }

    def take_over(self, told: Result) -> WindowFit:
        """Leave law and prior as the fit left them that told this; return its result."""
        arrays = {name: told[name].numpy() for name in ("rms", "memory", "relevance")}
        self.parameters.write(told["law"])
        self.prior = replace(self.prior, relevance=arrays.pop("relevance"))
        return WindowFit(**arrays, **{name: told[name] for name in ("starts", "cost", "missed", "steps")})

    def _follow_prior(
        self, theta: Float[Tensor, " p"], now: Residuals, normal: NormalEquations
    ) -> tuple[Residuals, NormalEquations, float]:
        """Change the prior as the evidence asks, and what depends on it; the largest logarithm of a ratio."""
        left, before = eliminate_states(normal), self.prior
        with suppress(np.linalg.LinAlgError):  # a law that nothing determines yet
            self.prior = before.estimate_relevance(theta.numpy(), left.curvature)
        stiffer = self.prior.precision - before.precision
        changed = replace(
            normal,
            parameters=normal.parameters + np.diag(stiffer),
            parameters_gradient=normal.parameters_gradient + stiffer * (theta.numpy() - self.prior.mean),
        )
        ratio = self.prior.relevance / before.relevance
        return self._with_prior(theta, now), changed, float(np.abs(np.log(ratio)).max(initial=0.0))

    def _add_terms(self, theta: Float[Tensor, " p"], now: Residuals, least_gain: float) -> bool:
        """Add the absent terms that raise the evidence most to the prior; whether there are any."""
        present = self.prior
        self.prior = present.without_absent()
        left = eliminate_states(self.assemble(theta, now, self.differentiate(theta, now)))
        grown = present.add_group(left.curvature, left.right, least_gain=least_gain)
        self.prior = grown or present
        return grown is not None

    def _step(
        self,
        theta: Float[Tensor, " p"],
        starts: States,
        now: Residuals,
        slopes: "Slopes",
        normal: NormalEquations,
        *,
        damping: float,
        hold_law: bool,
    ) -> "Step | None":
        """A step of states and parameters with geodesic acceleration, or None where it leads too far.

        Least squares with many parameters lie in long curved valleys. A second-order term from the
        residuals' curvature along the step follows them.

        Source: Transtrum and Sethna 2012, arXiv:1201.5885.
        """
        step = solve_normal(normal, damping=damping)
        if step is None:
            return None
        states, law = (torch.from_numpy(part) for part in step)
        if hold_law:
            return Step(states, torch.zeros_like(theta))
        ahead = self.evaluate(theta + PROBE * law, starts + PROBE * states)
        if not np.isfinite(ahead.cost):
            return None
        position, gap = self._apply(slopes, *step)
        position = 2.0 / PROBE * ((ahead.position - now.position).flatten(1).numpy() / PROBE - position)
        gap = 2.0 / PROBE * ((ahead.gap - now.gap).numpy() / PROBE - gap)
        states_gradient, law_gradient = self._pull_back(slopes, position, gap)
        bent = replace(normal, states_gradient=states_gradient, parameters_gradient=law_gradient)
        second = solve_normal(bent, damping=damping)
        if second is None:
            return None
        scale = np.diag(normal.parameters)
        length, turn = (float(np.sqrt(scale @ each[1] ** 2)) for each in (step, second))
        if turn > MOST_TURN * length:
            return None
        return Step(*(torch.from_numpy(a + 0.5 * b) for a, b in zip(step, second, strict=True)))

    def _apply(
        self, slopes: "Slopes", states: Float64[np.ndarray, "K s"], law: Float64[np.ndarray, " p"]
    ) -> tuple[Float64[np.ndarray, "K r"], Float64[np.ndarray, "G s"]]:
        """How the residuals change to first order along a step."""
        by_state, by_law, here, along = slopes
        position = (by_state @ states[:, :, None])[:, :, 0] + by_law @ law
        gap = np.einsum("gas,gs->ga", here, states[self.before]) + along @ law
        return position, gap + states[self.before + 1] / self.coupling.numpy()

    def _pull_back(
        self,
        slopes: "Slopes",
        position: Float64[np.ndarray, "K r"],
        gap: Float64[np.ndarray, "G s"],
    ) -> tuple[Float64[np.ndarray, "K s"], Float64[np.ndarray, " p"]]:
        """Gradients by the window starts and by the parameters, less those of prior and guard."""
        by_state, by_law, here, along = slopes
        states = (by_state.mT @ position[:, :, None])[:, :, 0]
        states[self.before] += np.einsum("gab,ga->gb", here, gap)
        states[self.before + 1] += gap / self.coupling.numpy()
        by_law, along = (each.reshape(-1, each.shape[2]) for each in (by_law, along))
        return states, position.ravel() @ by_law + gap.ravel() @ along

    def differentiate(self, theta: Float[Tensor, " p"], now: Residuals) -> "Slopes":
        """Derivatives of the residuals by the window starts and by the parameters."""
        transition, sensitivity, last = self.parameters.differentiate(theta, now.path, self.windows)
        inverse_jacobian, by_map = self.parameters.differentiate_observation(theta, now.latents)
        k, n, d, before = *now.error.shape, self.before
        by_state = torch.empty(k, n, d, 2 * d, dtype=theta.dtype)
        by_law = torch.empty(k, n, d, len(theta), dtype=theta.dtype)
        for at in (slice(i, i + CHUNK) for i in range(0, k, CHUNK)):  # small enough for the cache
            by_state[at] = self._whiten(inverse_jacobian[at] @ transition[at, :-1, :d])
            # the map, whose coefficients are the first parameters, changes what is seen alone
            of_rollout = inverse_jacobian[at] @ sensitivity[at]
            by_law[at] = self._whiten(torch.cat([by_map[at], of_rollout], 3))
        inverse = (1.0 / self.coupling)[:, None]
        along = torch.cat([last.new_zeros(len(before), 2 * d, by_map.shape[3]), -inverse * last[before]], 2)
        return Slopes(
            by_state.view(k, n * d, -1).numpy(),
            by_law.view(k, n * d, -1).numpy(),
            (-inverse * transition[before, -1]).numpy(),
            along.numpy(),
        )

    def assemble(self, theta: Float[Tensor, " p"], now: Residuals, slopes: "Slopes") -> NormalEquations:
        """The normal equations of a Gauss-Newton step."""
        before, inverse = self.before, (1.0 / self.coupling).numpy()
        by_state, by_law, here, along = slopes
        p, residual, gap = len(theta), now.position.flatten(1).numpy(), now.gap.numpy()
        states, mixed = by_state.mT @ by_state, by_state.mT @ by_law
        states_gradient, law_gradient = self._pull_back(slopes, residual, gap)
        link = np.zeros_like(states)
        states[before] += here.mT @ here
        states[before + 1] += np.diag(inverse**2)
        link[before] = here.mT * inverse
        mixed[before] += here.mT @ along
        mixed[before + 1] += inverse[:, None] * along
        prior = self.prior.precision
        law = np.diag(prior)
        for rows in (by_law.reshape(-1, p), along.reshape(-1, p)):
            law = law + rows.T @ rows
        law_gradient = law_gradient + prior * (theta.numpy() - self.prior.mean)
        if self.guard is not None:
            lacking, by_law = (part.numpy() for part in self.guard.measure(theta))
            law, law_gradient = law + by_law.T @ by_law, law_gradient + by_law.T @ lacking
        return NormalEquations(states, mixed, law, states_gradient, law_gradient, link)

    def measure_evidence(self, fitted: WindowFit) -> float:
        """Logarithm of the evidence of a law [nat].

        The window starts and the parameters are integrated out, by Laplace's method. Priors, and how far the
        motion may depart from a law between windows, are compared by it.

        Raises:
            numpy.linalg.LinAlgError: the starts are not determined.

        Source: MacKay 1992, DOI 10.1162/neco.1992.4.3.415.
        """
        theta = self.parameters.read()
        now = self.evaluate(theta, fitted.starts)
        normal = self.assemble(theta, now, self.differentiate(theta, now))
        left = eliminate_states(normal)
        k, n, _ = now.position.shape
        fresh = self.noise.log() + 0.5 * (n - 1) / n * (1.0 - self.memory**2).log()
        log_norm = k * n * float(fresh.sum()) + len(now.gap) * float(self.coupling.log().sum())
        log_volume = float(np.log(self.prior.precision).sum()) - left.log_determinant
        log_volume -= np.linalg.slogdet(left.curvature)[1]
        return float(0.5 * log_volume - log_norm - now.cost)

    def score_windows(self, fitted: WindowFit) -> "WindowScores":
        """Scores of the likelihood, with the window starts eliminated, at the parameters as they are.

        Raises:
            numpy.linalg.LinAlgError: the starts are not determined.
        """
        theta = self.parameters.read()
        now = self.evaluate(theta, fitted.starts)
        slopes = self.differentiate(theta, now)
        normal, (by_state, by_law, here, along) = self.assemble(theta, now, slopes), slopes
        left = eliminate_states(normal)
        answer = left.answer()
        residual, gap = now.position.flatten(1).numpy(), now.gap.numpy()
        rows = by_law - by_state @ answer
        scores, each = np.einsum("knp,kn->kp", rows, residual), rows.mT @ rows
        after = answer[self.before + 1] / self.coupling.numpy()[:, None]
        rows = along - here @ answer[self.before] - after
        scores[self.before] += np.einsum("gsp,gs->gp", rows, gap)
        each[self.before] += rows.mT @ rows
        # a scale of all energies has no answer: it is held
        scale = self.parameters.scale_direction().numpy()
        scale = scale / np.linalg.norm(scale)
        held = np.trace(left.curvature) * np.outer(scale, scale)
        return WindowScores(scores, each, left.curvature + held)


class Step(NamedTuple):
    """A step of the window starts and of the parameters."""

    states: States
    law: Float[Tensor, " p"]


class Slopes(NamedTuple):
    """Derivatives of the latents, and of the gaps by the start before them and by the parameters."""

    position_by_state: Float64[np.ndarray, "K r s"]
    position_by_law: Float64[np.ndarray, "K r p"]
    gap_by_state: Float64[np.ndarray, "G s s"]
    gap_by_law: Float64[np.ndarray, "G s p"]


class WindowScores(NamedTuple):
    """Gradient and information of the misfit of each window, and all information, the prior's included."""

    scores: Float64[np.ndarray, "K p"]
    each: Float64[np.ndarray, "K p p"]
    information: Float64[np.ndarray, "p p"]


def fit_windows(
    lagrangian: Lagrangian,
    measured: EncodedTrajectory,
    smooth: EncodedTrajectory,
    segments: Sequence[tuple[int, int]],
    *,
    n: int,
    coupling: float,
    noise: Float64[np.ndarray, " d"],
    memory: Float64[np.ndarray, " d"],
    iterations: int,
    least_gain: float,
    least_share: float = 0.0,
    hold_law: bool = False,
    least_growth: float | None = None,
    relevance: Float64[np.ndarray, " g"] | None = None,
    near: tuple[MultipleShooting, WindowFit] | None = None,
    recall: Recall = solve_anew,
) -> tuple[MultipleShooting, WindowFit]:
    """Fit a law in place to windows of ``n`` steps; return the problem and its solution.

    Args:
        lagrangian: the law to start from.
        measured, smooth: the trajectory as encoded, and smoothed: the first guess of the window starts.
        segments: parts of the trajectory that are used.
        n: steps of a window.
        coupling: standard deviation of the gaps between windows, relative to the rms of the states.
        noise, memory: standard deviation of the encoded positions, and its correlation from frame to frame.
        iterations: Gauss-Newton steps at most.
        least_gain, least_share: of a step [nat], and relative to the misfit; fits end after smaller ones.
        hold_law: fit the window starts alone.
        least_growth: gain of evidence for which terms are added [nat]; None leaves the prior as it is.
        relevance: of the groups of the prior, at first.
        near: a fit of the same function; its window starts are the first guess if its windows are these, and
            points at which its map came near a fold are guarded.
        recall: of the results of an earlier process.

    Raises:
        ValueError: no part is as long as a window.
    """
    unit = float(lagrangian.time_unit_s)
    windows = cut_windows(measured, segments, n=n, time_unit_s=unit, longest_step=lagrangian.longest_step)
    parameters = ParameterVector(lagrangian)
    lagrangian.move_ball(torch.from_numpy(measured.latents))
    velocity = torch.from_numpy(unit * smooth.differentiate(1))
    with torch.no_grad():
        state = torch.cat(parameters.coordinates.push(torch.from_numpy(smooth.latents), velocity), 1)
    size = coupling * (state.std(0, correction=0).numpy() + 1e-12)
    guard = Guard(parameters, measured, seed=0)
    if near is not None and near[0].guard is not None:
        guard.keep_folds(near[0].guard)
    prior = make_prior(parameters, relevance)
    problem = MultipleShooting(
        parameters, windows, noise=noise, memory=memory, coupling=size, guard=guard, prior=prior
    )
    starts = state[torch.from_numpy(windows.frames)]
    if near is not None and near[0].windows.n == n and np.array_equal(near[0].windows.frames, windows.frames):
        starts = near[1].starts
    fit = partial(
        problem.fit_and_tell,
        iterations=iterations,
        least_gain=least_gain,
        least_share=least_share,
        hold_law=hold_law,
        least_growth=least_growth,
    )
    fitted = problem.take_over(recall(partial(fit, starts)))
    for _ in range(REGUARDED):
        with torch.no_grad():
            if not guard.add_folds(parameters.coordinates):
                break
        fitted = problem.take_over(recall(partial(fit, fitted.starts)))
    return problem, fitted
