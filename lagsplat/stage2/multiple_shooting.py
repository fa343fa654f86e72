"""Maximum likelihood of a law by Gauss-Newton multiple shooting with variational equations.

The trajectory as encoded is cut into windows. Unknown are the parameters of the law and the state at the
start of every window, in the coordinates of the law. Residuals are the encoded positions less those of the
rollouts, as latents, in units of their noise, which is autoregressive; and the gaps between the end of a
window and the start of the next, in units of a coupling that is tightened from fit to fit. Loose windows
converge from a poor law; coupled ones do not let free starts absorb what the law gets wrong. The states are
eliminated window by window, so that a step solves one system of the size of the parameters. Steps are damped
as Levenberg and Marquardt do.

Source: Bock 1983, "Recent advances in parameter identification techniques for O.D.E."; Marquardt 1963,
DOI 10.1137/0111030.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import partial
from typing import NamedTuple

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64, Int
from scipy.linalg import cho_factor, cho_solve
from torch import Tensor

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.stage2 import polynomial_kernels
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.stage2.polynomials import (
    CHECKED,
    LOADS,
    PolynomialMap,
    REACH,
    SPRINGS,
    draw_states,
    evaluate_monomials,
    list_law_arrays,
    measure_stretch,
)
from lagsplat.stage2.rollout import interpolate_inputs, split_inputs

States = Float[Tensor, "K s"]  # position and velocity [per internal time unit] in the coordinates of the law
Paths = Float[Tensor, "K n s"]

# The numbers below were set by hand, with both simulated arms, the rocker and the toy in view.
STRETCHES = 8  # into which the used part of a long recording is divided
FIRST_DAMPING, LEAST_DAMPING = 1e-3, 1e-9
ATTEMPTS, STRENGTHENED, WEAKENED = 16, 4.0, 8.0  # of a step, and factors of its damping where it fails or not
SMALL_GAINS = 2  # in a row, after which a fit ends: one alone may be a bend of the valley
PROBE, MOST_TURN = (
    0.1,
    0.75,
)  # share of a step for its curvature, and the largest second-order term (the source's)
MOST_MISSED = 3.0  # times the rms of the motion, from which a fit does not begin
LONGEST_MEMORY = 0.98  # of autoregressive noise, below a random walk, which would say nothing of positions
VAGUE = 1e-2  # precision of the prior about the coefficients of a linear law
import os
EDGE = float(os.environ.get('EDGE','3'))  # of the data [standard deviations]
FRAME_AT_EDGE = 1.0  # standard deviation there of what each monomial adds to a frame or a map's Jacobian
ENERGY_AT_EDGE = 1.0  # and to an energy, where a spring of stiffness one has 4.5
MAP_GUARDED = 1024
ADDED, REGUARDED = 256, 4
GUARDED, BEYOND = 256, 0.25  # points of the guard, and how far they lie beyond two states
FAR = 1e6  # where a spring alone is left [whitened units]
LEAST_STIFFNESS = 0.05  # there, where the mean stiffness is about 1
LACKING_STIFFNESS = 0.02  # standard deviation of what may lack
LEAST_STRETCH, LACKING_STRETCH = 0.2, 0.02  # the same of the Jacobian of the map, the identity at q = 0
FASTEST = 10.0  # change of the relevance of a group in a step
SETTLED = 0.2  # change of its logarithm
LEAST_RELEVANCE, MOST_RELEVANCE, ABSENT = 1e-3, 1e6, 1e8
RELEVANCES = 10.0 ** np.arange(-2.0, 5.5, 0.5)
MAP = "coordinates.coefficients"
KERNEL_ORDER = (
    "mass_term.factor",
    "mass_term.frame.coefficients",
    "damping_term.factor",
    "energy.coefficients",
    "energy.input_coefficients",
)


@dataclass(frozen=True)
class Windows:
    """Windows of ``n`` steps of a trajectory; the next one follows the ``linked`` ones without a gap."""

    targets: Float[Tensor, "K m d"]
    inputs: Float[Tensor, "K n nodes n_u"]
    steps: Float[Tensor, "K n"]  # in internal time units
    frames: Int[np.ndarray, " K"]  # at which they begin
    linked: Bool[np.ndarray, " K"]

    @property
    def n(self) -> int:
        """Steps of a window."""
        return self.steps.shape[1]


def choose_stretches(segments: Sequence[tuple[int, int]], *, frames: int) -> list[tuple[int, int]]:
    """Choose at most about ``frames`` frames of the segments, in long stretches that are spread evenly."""
    total = sum(stop - start for start, stop in segments)
    if total <= frames:
        return list(segments)
    length = max(2, frames // STRETCHES)
    chosen = []
    for start, stop in segments:
        count = max(1, round(STRETCHES * (stop - start) / total))
        size = min(length, (stop - start) // count)
        for first in np.linspace(start, stop - size, count).astype(int):
            chosen.append((int(first), int(first) + size))
    return chosen


def cut_windows(
    trajectory: EncodedTrajectory,
    segments: Sequence[tuple[int, int]],
    *,
    n: int,
    time_unit_s: float,
    longest_step: float,
) -> Windows:
    """Cut windows of ``n`` steps, one after another, from parts of a trajectory.

    Raises:
        ValueError: no part is as long as a window.
    """
    frames, linked = [], []
    for start, stop in segments:
        count = (stop - 1 - start) // n
        frames += [start + k * n for k in range(count)]
        linked += [k + 1 < count for k in range(count)]
    if not frames:
        longest = max((stop - start for start, stop in segments), default=0)
        raise ValueError(
            f"the longest training segment has {longest} frames and a window of the fit needs {n + 1}: "
            "record longer clips or lower stage2.likelihood.periods"
        )
    at = np.array(frames)
    steps = np.diff(trajectory.time_s[at[:, None] + np.arange(n + 1)], axis=1) / time_unit_s
    nodes = 2 * split_inputs(float(steps.max()), longest_step) + 1
    inputs = torch.zeros(len(trajectory.inputs), nodes, trajectory.inputs.shape[1], dtype=torch.float64)
    for start, stop in trajectory.segments:
        series = torch.from_numpy(trajectory.inputs[None, start:stop])
        inputs[start : stop - 1] = interpolate_inputs(series, nodes=nodes)[0]
    return Windows(
        targets=torch.from_numpy(trajectory.latents[at[:, None] + np.arange(n + 1)]),
        inputs=inputs[torch.from_numpy(at[:, None] + np.arange(n))],
        steps=torch.from_numpy(steps),
        frames=at,
        linked=np.array(linked),
    )


class ParameterVector:
    """The free parameters of a polynomial law as one vector, and rollouts as a function of it."""

    def __init__(self, lagrangian: Lagrangian) -> None:
        assert lagrangian.coordinates is not None
        self.lagrangian, self.terms = lagrangian, lagrangian.polynomials
        self.coordinates = lagrangian.coordinates
        self.parts = {name: p for name, p in lagrangian.named_parameters() if p.requires_grad}
        assert tuple(self.parts) == (MAP, *KERNEL_ORDER)

    def read(self) -> Float[Tensor, " p"]:
        """The parameters as they are."""
        return torch.cat([p.detach().reshape(-1) for p in self.parts.values()])

    def write(self, theta: Float[Tensor, " p"]) -> None:
        """Set the parameters of the law."""
        with torch.no_grad():
            for parameter, value in zip(self.parts.values(), self._split(theta).values(), strict=True):
                parameter.copy_(value)

    def find_columns(self, *names: str) -> Int[Tensor, " n"]:
        """Places of some parts in the vector, part by part."""
        sizes = [p.numel() for p in self.parts.values()]
        first = dict(zip(self.parts, np.cumsum([0, *sizes[:-1]]).tolist(), strict=True))
        return torch.cat([first[name] + torch.arange(self.parts[name].numel()) for name in names])

    def weigh_prior(self) -> tuple[Float[Tensor, " p"], Float[Tensor, " p"]]:
        """Mean and precision of the prior.

        It is vague about the parameters as they are, and expects of each monomial above a spring's, and of
        the frame and the map, to be small at the edge of the data. What the recording does not determine is
        left out so.
        """
        energy, mass, _ = self.terms
        def scale(exponents):
            return torch.exp(exponents.sum(1) * np.log(EDGE) + 0.5 * torch.lgamma(exponents + 1.0).sum(1))

        bend = self.coordinates.exponents.sum(1)
        sizes = {
            "mass_term.frame.coefficients": scale(mass.frame.exponents)[:, None, None] / FRAME_AT_EDGE,
            MAP: (scale(self.coordinates.exponents) * bend)[:, None] / EDGE / FRAME_AT_EDGE,
        }
        for name, exponents, free in (
            ("", energy.exponents, SPRINGS),
            ("input_", energy.input_exponents, LOADS),
        ):
            sizes[f"energy.{name}coefficients"] = torch.where(
                exponents.sum(1) > free, scale(exponents) / ENERGY_AT_EDGE, 0.0
            )
        mean, precision = [], []
        for name, p in self.parts.items():
            size = sizes.get(name, torch.zeros(())).expand_as(p).reshape(-1)
            mean.append(torch.where(size > 0.0, 0.0, p.detach().reshape(-1)))
            precision.append(torch.where(size > 0.0, size.square(), VAGUE))
        return torch.cat(mean), torch.cat(precision).double()

    def list_groups(self) -> list[Int[Tensor, " n"]]:
        """Places of the parameters that make a law more than linear: of the map, the frame, V and nu."""
        energy, _, _ = self.terms
        above = {
            MAP: torch.tensor(True),
            "mass_term.frame.coefficients": torch.tensor(True),
            "energy.coefficients": energy.exponents.sum(1) > SPRINGS,
            "energy.input_coefficients": energy.input_exponents.sum(1) > LOADS,
        }
        groups = [self.find_columns(name)[each.expand_as(self.parts[name]).reshape(-1)] for name, each in above.items()]
        return [group for group in groups if len(group)]

    def scale_direction(self) -> Float[Tensor, " p"]:
        """How the parameters move when all energies and forces grow alike, which no motion shows."""
        shares = {"coefficients": 1.0, "input_coefficients": 1.0, "factor": 0.5}
        rows = []
        for name, p in self.parts.items():
            of_energy = name.startswith("energy.") or name.endswith("factor")
            rows.append(shares[name.split(".")[-1]] * of_energy * p.detach().reshape(-1))
        return torch.cat(rows)

    @torch.no_grad()
    def roll_out(self, theta: Float[Tensor, " p"], starts: States, windows: Windows) -> Paths:
        """States of all windows, the start included; leaves the law at ``theta``."""
        self.write(theta)
        return torch.from_numpy(
            polynomial_kernels.roll_out(
                list_law_arrays(*self.terms), starts.numpy(), windows.inputs.numpy(), windows.steps.numpy()
            )
        )

    @torch.no_grad()
    def observe(self, theta: Float[Tensor, " p"], x: Float[Tensor, "K n d"]) -> Float[Tensor, "K n d"]:
        """Latents at positions in the coordinates of the law; leaves the law at ``theta``."""
        self.write(theta)
        return self.coordinates.invert(x.flatten(0, 1)).view(x.shape)

    @torch.no_grad()
    def differentiate_observation(
        self, theta: Float[Tensor, " p"], q: Float[Tensor, "K n d"]
    ) -> tuple[Float[Tensor, "K n d d"], Float[Tensor, "K n d m"]]:
        """Derivatives of the latents ``q`` by the position and by the coefficients of the map."""
        self.write(theta)
        flat, shape = q.flatten(0, 1), q.shape
        value, _ = evaluate_monomials(flat, self.coordinates.exponents, ball=self.coordinates.ball)
        inverse = torch.linalg.inv(self.coordinates.evaluate(flat)[1])
        by_map = -torch.einsum("bij,bk->bikj", inverse, value)
        return inverse.view(*shape, -1), by_map.reshape(*shape, -1)

    @torch.no_grad()
    def differentiate(
        self, theta: Float[Tensor, " p"], path: Paths, windows: Windows
    ) -> tuple[Float[Tensor, "K n s s"], Float[Tensor, "K n s k"]]:
        """Derivatives of every state by the start of its window and by all parameters but the map's."""
        self.write(theta)
        transition, sensitivity = polynomial_kernels.differentiate_path(
            list_law_arrays(*self.terms), path.numpy(), windows.inputs.numpy(), windows.steps.numpy()
        )
        return torch.from_numpy(transition), torch.from_numpy(sensitivity)

    def _split(self, theta: Tensor) -> dict[str, Tensor]:
        pieces = theta.split([p.numel() for p in self.parts.values()])
        return {name: x.view(p.shape) for (name, p), x in zip(self.parts.items(), pieces, strict=True)}


class Guard:
    """Points at which the map of a law must stay invertible and its energy stable.

    Where the loaded stiffness is positive between the states of the recording, there is one equilibrium at
    most. Without the guard, polynomials that fit the states bend down beside them, and maps fold.

    Args:
        parameters: of the law.
        trajectory: states and inputs; a point of the energy mixes two states, a little beyond both, and any
            input; one lies far outside.
        seed: of the points.
    """

    def __init__(self, parameters: ParameterVector, trajectory: EncodedTrajectory, *, seed: int) -> None:
        energy, coordinates = parameters.terms[0], parameters.coordinates
        q, u = trajectory.latents, trajectory.inputs
        self.eye = torch.eye(q.shape[1], dtype=torch.float64)
        around = draw_states(coordinates.ball, MAP_GUARDED, reach=REACH, seed=seed)
        self.slopes = evaluate_monomials(around, coordinates.exponents, ball=coordinates.ball)[1]
        rng = np.random.default_rng(seed)
        share = rng.uniform(-BEYOND, 1.0 + BEYOND, (GUARDED, 1))
        one, other = q[rng.integers(len(q), size=(2, GUARDED))]
        at = torch.from_numpy(np.clip(share * one + (1.0 - share) * other, q.min(axis=0), q.max(axis=0)))
        load = torch.from_numpy(rng.uniform(u.min(axis=0), u.max(axis=0), (GUARDED, u.shape[1])))
        with torch.no_grad():  # the stiffness is that at the points as the map is now
            at, _ = coordinates.evaluate(at)
        at, load = torch.cat([at, at[:1] + FAR]), torch.cat([load, load[:1]])
        (_, elastic), (_, pushed) = energy.differentiate_terms(at)
        loaded = -torch.einsum("nc,nkij->nckij", load, pushed).flatten(1, 2)
        self.curvatures = torch.cat([elastic, loaded], 1)  # of the energy
        self.of_map = parameters.find_columns(MAP)
        self.of_energy = parameters.find_columns("energy.coefficients", "energy.input_coefficients")

    def add_folds(self, coordinates: PolynomialMap) -> bool:
        """Add points at which a map has come near a fold in spite of the guard; whether there are any."""
        states = draw_states(coordinates.ball, CHECKED, reach=REACH, seed=0)
        stretch = measure_stretch(coordinates.evaluate(states)[1])[0]
        near = stretch.argsort()[:ADDED]
        near = near[stretch[near] < 0.5 * LEAST_STRETCH]
        slopes = evaluate_monomials(states[near], coordinates.exponents, ball=coordinates.ball)[1]
        self.slopes = torch.cat([self.slopes, slopes])
        return bool(len(near))

    def measure(self, theta: Float[Tensor, " p"]) -> tuple[Float[Tensor, " n"], Float[Tensor, "n p"]]:
        """What stiffness and stretch lack, in units of what may lack, and its derivatives by ``theta``."""
        stiffness = torch.einsum("k,nkij->nij", theta[self.of_energy], self.curvatures)
        values, vectors = torch.linalg.eigh(stiffness)
        weakest = vectors[:, :, 0]
        by_energy = torch.einsum("ni,nkij,nj->nk", weakest, self.curvatures, weakest)
        coefficients = theta[self.of_map].view(-1, len(self.eye))
        stretch, outer = measure_stretch(self.eye + torch.einsum("ki,nkl->nil", coefficients, self.slopes))
        by_map = torch.einsum("nil,nkl->nki", outer, self.slopes).flatten(1)
        lacking, rows = [], []
        for value, columns, by_column, least, unit in (
            (values[:, 0], self.of_energy, by_energy, LEAST_STIFFNESS, LACKING_STIFFNESS),
            (stretch, self.of_map, by_map, LEAST_STRETCH, LACKING_STRETCH),
        ):
            short = (least - value).clamp(min=0.0)
            row = theta.new_zeros(len(short), len(theta))
            row[:, columns] = -by_column * (short > 0.0)[:, None]
            lacking.append(short / unit)
            rows.append(row / unit)
        return torch.cat(lacking), torch.cat(rows)


@dataclass(frozen=True)
class Residuals:
    """Paths of all windows, their errors, residuals of unit size, and half the sum of their squares."""

    path: Paths
    latents: Float[Tensor, "K n d"]  # without the last state of a window, which is the first of the next
    error: Float[Tensor, "K n d"]  # of latents, before the noise's memory and size are taken out
    position: Float[Tensor, "K n d"]
    gap: Float[Tensor, "G s"]
    cost: float


@dataclass(frozen=True)
class NormalEquations:
    """The system ``[[states, mixed], [mixed^T, law]] x = -gradient``, its states chained by ``link``."""

    states: Float64[np.ndarray, "K s s"]
    link: Float64[np.ndarray, "K s s"]  # between a state and the next
    mixed: Float64[np.ndarray, "K s p"]
    law: Float64[np.ndarray, "p p"]
    states_gradient: Float64[np.ndarray, "K s"]
    law_gradient: Float64[np.ndarray, " p"]


@dataclass(frozen=True)
class WindowFit:
    """Result of a fit: states at the window starts; rms residual of each coordinate and its correlation.

    ``missed`` is the larger of that and the rms gap, of the worst coordinate [whitened units].
    """

    starts: States
    rms: Float64[np.ndarray, " d"]
    memory: Float64[np.ndarray, " d"]
    cost: float
    missed: float
    steps: int


class MultipleShooting:
    """A fit in progress.

    Args:
        parameters: of the law.
        windows: of the trajectory.
        noise: standard deviation of the encoded positions, one for each coordinate.
        memory: correlation of the noise from frame to frame: it is autoregressive.
        coupling: standard deviation of the gaps between windows, one for each position and velocity.
        guard: keeps the map invertible and the loaded stiffness positive.
    """

    def __init__(
        self,
        parameters: ParameterVector,
        windows: Windows,
        *,
        noise: Float64[np.ndarray, " d"],
        memory: Float64[np.ndarray, " d"],
        coupling: Float64[np.ndarray, " s"],
        guard: Guard | None = None,
        relevance: Float64[np.ndarray, " g"] | None = None,
    ) -> None:
        self.parameters, self.windows, self.guard = parameters, windows, guard
        self.noise, self.memory = torch.from_numpy(noise), torch.from_numpy(memory)
        self.coupling = torch.from_numpy(coupling)
        self.before = np.flatnonzero(windows.linked)
        self.prior_mean, self.unit_precision = parameters.weigh_prior()
        self.groups = parameters.list_groups()
        self.relevance = np.ones(len(self.groups)) if relevance is None else relevance

    @property
    def precision(self) -> Float[Tensor, " p"]:
        """Of the prior of each parameter."""
        precision = self.unit_precision.clone()
        for group, relevance in zip(self.groups, self.relevance, strict=True):
            precision[group] *= relevance
        return precision

    def estimate_relevance(
        self, theta: Float[Tensor, " p"], normal: NormalEquations
    ) -> Float64[np.ndarray, " g"]:
        """Precisions of the priors of the groups that the recording asks for; those without any stay so.

        Source: MacKay 1992, DOI 10.1162/neco.1992.4.3.415.
        """
        states = eliminate_states(normal, self.windows.linked, damping=0.0)
        variance = np.diag(np.linalg.inv(states.law))
        precision, estimated = self.precision.numpy(), self.relevance.copy()
        for i, (group, before) in enumerate(zip(self.groups, self.relevance, strict=True)):
            if before == ABSENT:
                continue
            determined = float(np.sum(1.0 - precision[group] * variance[group]))
            size = float((self.unit_precision[group] * theta[group].square()).sum())
            after = np.clip(max(determined, 1e-3) / max(size, 1e-12), before / FASTEST, before * FASTEST)
            estimated[i] = ABSENT if after > MOST_RELEVANCE else max(after, LEAST_RELEVANCE)
        return estimated

    def find_missing_group(
        self, theta: Float[Tensor, " p"], now: Residuals
    ) -> tuple[float, int, float]:
        """Gain of evidence [nat] of the absent group that lacks most, its number and its relevance.

        Source: Tipping and Faul 2003, "Fast marginal likelihood maximisation for sparse Bayesian models".
        """
        present, absent = self.relevance, np.flatnonzero(self.relevance == ABSENT).tolist()
        self.relevance = np.where(present == ABSENT, 0.0, present)
        normal = self.assemble(theta, now, self.differentiate(theta, now))
        self.relevance = present
        states = eliminate_states(normal, self.windows.linked, damping=0.0)
        inside = np.ones(len(theta), dtype=bool)
        for i in absent:
            inside[self.groups[i]] = False
        best = (0.0, -1, ABSENT)
        try:
            factor = cho_factor(states.law[np.ix_(inside, inside)])
        except np.linalg.LinAlgError:
            return best
        for i in absent:
            group, unit = self.groups[i].numpy(), self.unit_precision[self.groups[i]].numpy()
            across = states.law[np.ix_(inside, group)]
            solved = cho_solve(factor, across)
            scale = 1.0 / np.sqrt(unit)  # parameters of unit size at relevance one
            information = states.law[np.ix_(group, group)] - across.T @ solved
            information = scale[:, None] * information * scale
            slope = scale * (states.law_right[group] - solved.T @ states.law_right[inside])
            values, vectors = np.linalg.eigh(information)
            values, along = np.maximum(values, 0.0), np.square(vectors.T @ slope)
            for relevance in RELEVANCES:
                gain = 0.5 * float(np.sum(along / (values + relevance) - np.log1p(values / relevance)))
                best = max(best, (gain, i, relevance))
        return best

    def fit(
        self,
        starts: States,
        *,
        iterations: int,
        least_gain: float,
        least_share: float = 0.0,
        hold_law: bool = False,
        learn_prior: bool = False,
        least_growth: float = 2.0,
    ) -> WindowFit:
        """Take damped Gauss-Newton steps, and leave the law at the best parameters.

        It ends when the logarithm of the posterior density grows less than ``least_gain`` twice in a row, or
        once by less than ``least_share`` of the misfit.
        With ``hold_law`` the states at the window starts move alone.
        """
        theta, damping, steps, small = self.parameters.read(), FIRST_DAMPING, 0, 0
        now = self.evaluate(theta, starts)
        # slopes of windows that diverge lead nowhere
        lost = not self._missed(now) < MOST_MISSED
        for _ in range(0 if lost else iterations):
            slopes = self.differentiate(theta, now)
            normal = self.assemble(theta, now, slopes)
            changed = 0.0
            if steps and learn_prior:
                relevance = self.estimate_relevance(theta, normal)
                changed = float(np.abs(np.log(relevance / self.relevance)).max(initial=0.0))
                self.relevance = relevance
                now = self.evaluate(theta, starts)
                normal = self.assemble(theta, now, slopes)
            for _ in range(ATTEMPTS):
                with np.errstate(all="ignore"):  # a step that overflows is refused
                    step = self._step(theta, starts, now, slopes, normal, damping=damping, hold_law=hold_law)
                if step is not None:
                    after = self.evaluate(theta + step[1], starts + step[0])
                    if after.cost < now.cost:
                        break
                damping *= STRENGTHENED
            else:
                break
            gain = now.cost - after.cost
            small = small + 1 if gain < least_gain and changed < SETTLED else 0
            theta, starts, now = theta + step[1], starts + step[0], after
            damping, steps = max(damping / WEAKENED, LEAST_DAMPING), steps + 1
            if small == SMALL_GAINS or gain < least_share * now.cost:
                if not learn_prior:
                    break
                grown = self.find_missing_group(theta, now)
                if grown[0] < least_growth:
                    break
                self.relevance = self.relevance.copy()
                self.relevance[grown[1]] = grown[2]
                now, small, damping = self.evaluate(theta, starts), 0, FIRST_DAMPING
        self.parameters.write(theta)
        error = now.error.numpy()
        power = np.mean(error**2, axis=(0, 1)) + 1e-300
        memory = np.mean(error[:, 1:] * error[:, :-1], axis=(0, 1)) / power
        return WindowFit(
            starts, np.sqrt(power), np.clip(memory, 0.0, LONGEST_MEMORY), now.cost, self._missed(now), steps
        )

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
    ) -> tuple[States, Float[Tensor, " p"]] | None:
        """A step of states and parameters with geodesic acceleration, or None where it leads too far.

        Least squares with many parameters lie in long curved valleys. A second-order term from the
        residuals' curvature along the step follows them.

        Source: Transtrum and Sethna 2012, arXiv:1201.5885.
        """
        linked = self.windows.linked
        step = solve_normal(normal, linked, damping=damping)
        if step is None:
            return None
        if hold_law:
            return step[0], torch.zeros_like(theta)
        states, law = step
        ahead = self.evaluate(theta + PROBE * law, starts + PROBE * states)
        if not np.isfinite(ahead.cost):
            return None
        position, gap = self._apply(slopes, states.numpy(), law.numpy())
        position = 2.0 / PROBE * ((ahead.position - now.position).flatten(1).numpy() / PROBE - position)
        gap = 2.0 / PROBE * ((ahead.gap - now.gap).numpy() / PROBE - gap)
        states_gradient, law_gradient = self._pull_back(slopes, position, gap)
        bent = replace(normal, states_gradient=states_gradient, law_gradient=law_gradient)
        second = solve_normal(bent, linked, damping=damping)
        if second is None:
            return None
        scale = np.diag(normal.law)
        length, turn = (float(np.sqrt(scale @ each[1].numpy() ** 2)) for each in (step, second))
        if turn > MOST_TURN * length:
            return None
        return states + 0.5 * second[0], law + 0.5 * second[1]

    def _apply(
        self, slopes: "Slopes", states: Float64[np.ndarray, "K s"], law: Float64[np.ndarray, " p"]
    ) -> tuple[Float64[np.ndarray, "K r"], Float64[np.ndarray, "G s"]]:
        """How the residuals change to first order along a step."""
        by_state, by_law, here, along = slopes
        position = np.einsum("krs,ks->kr", by_state, states) + by_law @ law
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
        states = np.einsum("krs,kr->ks", by_state, position)
        states[self.before] += np.einsum("gab,ga->gb", here, gap)
        states[self.before + 1] += gap / self.coupling.numpy()
        return states, np.einsum("krp,kr->p", by_law, position) + np.einsum("gsp,gs->p", along, gap)

    def _missed(self, now: Residuals) -> float:
        position = now.error.square().mean((0, 1)).sqrt()
        gap = now.gap.square().mean(0).sqrt() * self.coupling if len(now.gap) else position
        return float(torch.cat([position, gap]).max())

    def evaluate(self, theta: Float[Tensor, " p"], starts: States) -> Residuals:
        """Roll out all windows and measure what they miss; the cost of a divergence is infinite."""
        path = self.parameters.roll_out(theta, starts, self.windows)
        latents = self.parameters.observe(theta, path[:, :-1, : len(self.noise)])
        error = latents - self.windows.targets[:, :-1]
        position = self._whiten(error[..., None])[..., 0]
        gap = (starts[self.before + 1] - path[self.before, -1]) / self.coupling
        prior = (self.precision * (theta - self.prior_mean).square()).sum()
        if self.guard is not None:
            prior = prior + self.guard.measure(theta)[0].square().sum()
        cost = 0.5 * float(position.square().sum() + gap.square().sum() + prior)
        return Residuals(path, latents, error, position, gap, cost if np.isfinite(cost) else float("inf"))

    def _whiten(self, residual: Float[Tensor, "K n d k"]) -> Float[Tensor, "K n d k"]:
        """Residuals as independent ones of unit size, window by window."""
        fresh = (self.noise * (1.0 - self.memory**2).sqrt())[:, None]
        later = (residual[:, 1:] - self.memory[:, None] * residual[:, :-1]) / fresh
        return torch.cat([residual[:, :1] / self.noise[:, None], later], 1)

    def differentiate(self, theta: Float[Tensor, " p"], now: Residuals) -> "Slopes":
        """Derivatives of the residuals by the window starts and by the parameters."""
        transition, sensitivity = self.parameters.differentiate(theta, now.path, self.windows)
        inverse_jacobian, by_map = self.parameters.differentiate_observation(theta, now.latents)
        k, d, before = len(now.path), len(self.noise), self.before
        by_state = inverse_jacobian @ transition[:, :-1, :d]
        # the map, whose coefficients are the first parameters, changes what is seen alone
        by_law = torch.cat([by_map, inverse_jacobian @ sensitivity[:, :-1, :d]], 3)
        inverse = (1.0 / self.coupling)[:, None]
        along = -inverse * sensitivity[before, -1]
        return Slopes(
            self._whiten(by_state).reshape(k, -1, 2 * d).numpy(),
            self._whiten(by_law).reshape(k, -1, len(theta)).numpy(),
            (-inverse * transition[before, -1]).numpy(),
            torch.cat([by_map.new_zeros(len(before), 2 * d, by_map.shape[3]), along], 2).numpy(),
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
        rows = np.concatenate([by_law.reshape(-1, p), along.reshape(-1, p)])
        prior = self.precision.numpy()
        law = rows.T @ rows + np.diag(prior)
        law_gradient = law_gradient + prior * (theta - self.prior_mean).numpy()
        if self.guard is not None:
            lacking, by_law = (part.numpy() for part in self.guard.measure(theta))
            law, law_gradient = law + by_law.T @ by_law, law_gradient + by_law.T @ lacking
        return NormalEquations(states, link, mixed, law, states_gradient, law_gradient)

    def measure_evidence(self, fitted: WindowFit) -> float:
        """Logarithm of the likelihood of the law, less half a logarithm of the data for each parameter [nat].

        The window starts are integrated out, by Laplace's method. Laws, and how far the motion may depart
        from them between windows, are compared by it.

        Raises:
            numpy.linalg.LinAlgError: the starts are not determined.

        Source: Schwarz 1978, DOI 10.1214/aos/1176344136.
        """
        theta = self.parameters.read()
        now = self.evaluate(theta, fitted.starts)
        normal = self.assemble(theta, now, self.differentiate(theta, now))
        states = eliminate_states(normal, self.windows.linked, damping=0.0)
        k, n, _ = now.position.shape
        fresh = self.noise.log() + 0.5 * (n - 1) / n * (1.0 - self.memory**2).log()
        log_norm = k * n * float(fresh.sum()) + len(now.gap) * float(self.coupling.log().sum())
        log_volume = float(np.linalg.slogdet(states.inverse)[1].sum())
        log_volume += float(self.precision.log().sum()) - np.linalg.slogdet(states.law)[1]
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
        states = eliminate_states(normal, self.windows.linked, damping=0.0)
        answer = np.empty_like(normal.mixed)  # of each start to the parameters
        for i in range(len(answer) - 1, -1, -1):
            answer[i] = states.mixed[i]
            if self.windows.linked[i]:
                answer[i] -= normal.link[i] @ answer[i + 1]
            answer[i] = states.inverse[i] @ answer[i]
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
        held = np.trace(states.law) * np.outer(scale, scale)
        return WindowScores(scores, each, states.law + held, self.precision.numpy())


class Slopes(NamedTuple):
    """Derivatives of the latents, and of the gaps by the start before them and by the parameters."""

    position_by_state: Float64[np.ndarray, "K r s"]
    position_by_law: Float64[np.ndarray, "K r p"]
    gap_by_state: Float64[np.ndarray, "G s s"]
    gap_by_law: Float64[np.ndarray, "G s p"]


class WindowScores(NamedTuple):
    """Gradient and information of the misfit of each window, all information, and the prior's part of it."""

    scores: Float64[np.ndarray, "K p"]
    each: Float64[np.ndarray, "K p p"]
    information: Float64[np.ndarray, "p p"]
    prior: Float64[np.ndarray, " p"]


class EliminatedStates(NamedTuple):
    """Inverse diagonal blocks of the eliminated states, what couples them to the law, and what is left."""

    inverse: Float64[np.ndarray, "K s s"]
    mixed: Float64[np.ndarray, "K s p"]
    right: Float64[np.ndarray, "K s"]
    law: Float64[np.ndarray, "p p"]
    law_right: Float64[np.ndarray, " p"]


def eliminate_states(
    normal: NormalEquations, linked: Bool[np.ndarray, " K"], *, damping: float
) -> EliminatedStates:
    """Eliminate the states in the order of time, as in a block-tridiagonal system.

    Raises:
        numpy.linalg.LinAlgError: a state is not determined.
    """
    k, s = normal.states_gradient.shape
    diagonal, p = np.arange(s), len(normal.law)
    states, mixed, right = normal.states.copy(), normal.mixed.copy(), -normal.states_gradient
    states[:, diagonal, diagonal] *= 1.0 + damping
    inverse = np.empty_like(states)
    for i in range(k):
        if i and linked[i - 1]:
            back = inverse[i - 1] @ normal.link[i - 1]
            states[i] -= normal.link[i - 1].T @ back
            mixed[i] -= back.T @ mixed[i - 1]
            right[i] -= back.T @ right[i - 1]
        inverse[i] = np.linalg.inv(states[i])
    solved = inverse @ mixed
    law = normal.law + damping * np.diag(np.diag(normal.law))
    law = law - mixed.reshape(-1, p).T @ solved.reshape(-1, p)
    law_right = -normal.law_gradient - np.einsum("ksp,ks->p", solved, right)
    return EliminatedStates(inverse, mixed, right, law, law_right)


def solve_normal(
    normal: NormalEquations, linked: Bool[np.ndarray, " K"], *, damping: float
) -> tuple[States, Float[Tensor, " p"]] | None:
    """Solve for the steps of states and parameters, or None where the equations are not positive definite."""
    try:
        left = eliminate_states(normal, linked, damping=damping)
        factor = np.linalg.cholesky(left.law)
    except np.linalg.LinAlgError:
        return None
    theta = np.linalg.solve(factor.T, np.linalg.solve(factor, left.law_right))
    starts = np.empty_like(normal.states_gradient)
    for i in range(len(starts) - 1, -1, -1):
        rest = left.right[i] - left.mixed[i] @ theta
        if linked[i]:
            rest = rest - normal.link[i] @ starts[i + 1]
        starts[i] = left.inverse[i] @ rest
    return torch.from_numpy(starts), torch.from_numpy(theta)


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
    learn_prior: bool = False,
    relevance: Float64[np.ndarray, " g"] | None = None,
    near: tuple[MultipleShooting, WindowFit] | None = None,
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
        near: a fit of the same function; its window starts are the first guess if its windows are these.

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
    problem = MultipleShooting(
        parameters, windows, noise=noise, memory=memory, coupling=size, guard=guard, relevance=relevance
    )
    starts = state[torch.from_numpy(windows.frames)]
    if near is not None and near[0].windows.n == n and np.array_equal(near[0].windows.frames, windows.frames):
        starts = near[1].starts
    fit = partial(
        problem.fit,
        iterations=iterations,
        least_gain=least_gain,
        least_share=least_share,
        hold_law=hold_law,
        learn_prior=learn_prior,
    )
    fitted = fit(starts)
    for _ in range(REGUARDED):
        with torch.no_grad():
            if not guard.add_folds(parameters.coordinates):
                break
        fitted = fit(fitted.starts)
    return problem, fitted
