"""Fits the Lagrangian to a latent trajectory, saves it and loads it.

A law of polynomials is the most likely one. Networks take it over and are fitted to the same likelihood. As
published, they begin with constant matrices and are trained on single steps; the best candidate is chosen by
its rollout error over the training clip, and steps after which the loss explodes are rolled back.
"""

import time
from collections import deque
from collections.abc import Callable, Mapping, Sequence
from contextlib import suppress
from dataclasses import asdict, dataclass, field, fields, replace
from functools import partial
from itertools import product
from pathlib import Path
from statistics import median
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.io.files.artifact import load_artifact, require_settings, restore_module, save_artifact
from lagsplat.stage1.training import decay_by_cosine
from lagsplat.stage2 import objective
from lagsplat.stage2.amplitude import measure_quietest_frequency
from lagsplat.stage2.config import FormConfig, Stage2Config
from lagsplat.stage2.decoder_mass import DecoderGeometry, InducedMass
from lagsplat.stage2.equilibrium import (
    LinearizedModes,
    NoEquilibriumError,
    linearize_modes,
    list_stable_equilibria,
    move_rest_to_equilibrium,
)
from lagsplat.stage2.finished_fits import Recall, Result, solve_anew
from lagsplat.stage2.input_stiffness import InputRange, InputStiffness, measure_input_range
from lagsplat.stage2.lagrangian import Coefficients, Floors, Lagrangian
from lagsplat.stage2.likelihood.fitted_law import FittedLaw
from lagsplat.stage2.likelihood.likelihood_fit import LikelihoodFit
from lagsplat.stage2.likelihood.network_fit import fit_networks, linearize_law, project_law
from lagsplat.stage2.likelihood.weak_form_fit import WeakFormFit
from lagsplat.stage2.linear_fit import ConstantFit, evaluate_one_step_error
from lagsplat.stage2.rollout import (
    ShootingWindows,
    list_one_step_windows,
    list_starts,
)
from lagsplat.stage2.validation import ForecastErrors, draw_validation_task

KIND = "dynamics"
SCHEMA = 3
RARE_REST = 0.99
"""Share of the recorded states nearer to their mean than the rest state, from which its modes are guesses;
set by hand."""
AMPLITUDE_SHIFT = 0.02
"""Relative change of the frequency from the smallest recorded amplitude to rest that is worth a warning; set
by hand."""


@dataclass(frozen=True)
class CurveRow:
    """One line of the training curve."""

    stage: str  # 'start', 'one_step', 'likelihood', 'projection' or 'networks'
    step: int
    loss: float
    score: float
    seconds: float


@dataclass
class FitReport:
    """Report of a fit: the best score after each stage, the learned modes and the training curve.

    A score is the rms rollout error over the rms of the training clip.
    """

    scores: dict[str, float] = field(default_factory=dict)
    curve: list[CurveRow] = field(default_factory=list)
    rejected: int = 0
    taken_back: int = 0  # steps after which the loss exploded
    time_unit_s: float = 0.0
    n_parameters: int = 0
    wall_s: float = 0.0
    at_rest: LinearizedModes | None = None  # of a law that has an equilibrium without inputs
    under_mean_input: LinearizedModes | None = None  # the same
    unsettled: str = ""  # why a polynomial law has no equilibrium without inputs, where it has none
    equilibria: int | None = None  # of a polynomial law, most under the mean and the extreme inputs
    rest_beyond: float | None = None  # share of the training states nearer to their mean than its rest state
    quietest_hz: float | None = None  # frequency of the law at the smallest amplitude of a free recording
    unused_steps: int = 0  # of the one-step objective, which a law of maximum likelihood does not take
    draws: Float64[np.ndarray, "n p"] | None = None  # parameters of laws that the recording allows as well

    @property
    def warnings(self) -> list[str]:
        """What a law of maximum likelihood says of itself that its user must know."""
        found = []
        if self.unused_steps:
            found.append(
                f"stage2.steps={self.unused_steps} has no effect: with start.source=likelihood no law is "
                "trained on single steps. Take stage2=paper, or stage2.likelihood.iterations"
            )
        if self.equilibria is None:
            return found
        if self.unsettled:
            found.append(
                f"the law has no rest state without inputs, and no modes there: {self.unsettled}. Record "
                "motion about rest, or lower stage2.form.potential_degree"
            )
        if self.equilibria != 1:
            found.append(
                f"the law has {self.equilibria} stable equilibria under an extreme input of the recording: "
                "pushed far, it may come to rest elsewhere. Record motion there, or lower "
                "stage2.form.potential_degree"
            )
        if self.rest_beyond is not None and self.rest_beyond > RARE_REST:
            found.append(
                f"the rest state lies farther out than {self.rest_beyond:.1%} of the recorded states: modes "
                "there are extrapolated, and their intervals do not know by how much. Record motion about "
                "rest, or read the modes under the mean input"
            )
        if self.quietest_hz is not None and self.at_rest is not None:
            at_rest = self.at_rest.frequency_hz[0]
            if abs(at_rest / self.quietest_hz - 1.0) > AMPLITUDE_SHIFT:
                found.append(
                    f"the law oscillates at {self.quietest_hz:.3g} Hz at the smallest amplitude of the "
                    f"recording and at {at_rest:.3g} Hz at rest, where it is extrapolated, and its interval "
                    "does not know by how much. Record the motion until it has died down"
                )
        if self.draws is None:
            found.append(
                "the law has no intervals: the recording is too short to be divided, or leaves a parameter "
                "open. Record longer, or check latent.png for noise"
            )
        return found


def fit_dynamics(
    trajectory: EncodedTrajectory,
    metric: Float[np.ndarray, "d d"],
    config: Stage2Config,
    seed: int,
    *,
    rest: Float[np.ndarray, " d"],
    geometry: DecoderGeometry | None = None,
    measured: EncodedTrajectory | None = None,
    on_candidate: Callable[[CurveRow], None] = lambda row: None,
    recall: Recall = solve_anew,
) -> tuple[Lagrangian, FitReport]:
    """Fit M, C, V and nu to a smoothed training trajectory in whitened latents.

    With ``config.start.source='likelihood'`` a law of polynomials is fitted by least squares on the balance
    of forces, and by maximum likelihood on the trajectory as ``measured``, where that is given; networks
    follow from it. Otherwise networks begin with constant matrices and are trained on the one-step objective.
    The result is the candidate with the smallest rollout error over the clip, so that no stage can make it
    worse.

    ``metric`` is the visibility metric without ridge, ``rest`` the encoding of the rest image, ``geometry``
    that of the decoder, for an induced mass. ``on_candidate`` is called with every scored candidate. Results
    of long steps pass through ``recall``, which may know them from a process that was stopped.

    Raises:
        ValueError: segments too short for a window, latents that do not move, or a missing geometry.

    Source: paper, "Stage 2: Latent Lagrangian Dynamics".
    """
    torch.manual_seed(seed)
    fit = DynamicsFit(trajectory, metric, config, seed, on_candidate, recall)
    report, best = fit.report, fit.best
    if config.start.source == "likelihood":
        report.unused_steps = config.steps
        fit.maximize_likelihood(measured or trajectory)
        if config.form.terms == "networks":
            fit.fit_networks(torch.from_numpy(rest), geometry)
    else:
        fit.start(torch.from_numpy(rest), geometry)
        fit.score_candidate("start", 0, float("nan"))
        report.scores["start"] = best.score
        fit.train_on_steps()
        report.scores["one_step"] = best.score
        best.restore(fit.lagrangian)
    lagrangian = fit.lagrangian
    report.rejected = best.rejected
    report.n_parameters = sum(p.numel() for p in lagrangian.parameters() if p.requires_grad)
    mean_input = torch.from_numpy(trajectory.inputs.mean(0))
    with suppress(NoEquilibriumError):
        report.at_rest = linearize_modes(lagrangian)
    with suppress(NoEquilibriumError):
        report.under_mean_input = linearize_modes(lagrangian, mean_input)
    report.wall_s = time.perf_counter() - fit.started_s
    return lagrangian, report


DRAWS = "parameter_draws"
LAW_SETTINGS = (
    *("d", "n_inputs", "form", "floors", "time_unit_s", "longest_step", "n_primitives", "curved", "signed"),
    "integrator",
)


def save_dynamics(
    path: Path | str,
    lagrangian: Lagrangian,
    header: Mapping[str, Any],
    report: FitReport | None = None,
) -> None:
    """Write the parameters with form, floors, unit of time and other settings of the law, and a report."""
    settings = {
        "d": lagrangian.d,
        "n_inputs": lagrangian.n_inputs,
        "form": asdict(lagrangian.form),
        "floors": asdict(lagrangian.floors),
        "time_unit_s": float(lagrangian.time_unit_s),
        "longest_step": lagrangian.longest_step,
        "n_primitives": getattr(lagrangian.mass_term, "n_primitives", None),
        "curved": lagrangian.curvature is not None,
        # absent where inputs have one sign
        **({"signed": True} if lagrangian.signed else {}),
        "integrator": lagrangian.integrator,
    }
    header = {**header, "kind": KIND, "schema": SCHEMA, "dynamics": settings}
    tensors = dict(lagrangian.state_dict())
    if report is not None:
        header["report"] = asdict(replace(report, draws=None))
        if report.draws is not None:
            tensors[DRAWS] = torch.from_numpy(report.draws)
    save_artifact(path, tensors, header)


def load_dynamics(path: Path | str) -> tuple[Lagrangian, dict[str, Any]]:
    """Read a Lagrangian and its header; every setting comes from the file.

    Raises:
        ValueError: the file is no dynamics, one of another schema, or lacks a setting.
    """
    tensors, header = load_artifact(path, kind=KIND, schema=SCHEMA)
    tensors.pop(DRAWS, None)
    settings = header["dynamics"]
    require_settings(path, header, {"signed", *settings}, LAW_SETTINGS)
    require_settings(path, header, settings["form"], [each.name for each in fields(FormConfig)])
    d, n_inputs, k = settings["d"], settings["n_inputs"], settings["n_primitives"]
    eye, blank = torch.eye(d, dtype=torch.float64), torch.zeros(n_inputs, d, dtype=torch.float64)
    signed, input_stiffness, geometry = settings.get("signed", False), None, None
    if settings["curved"]:
        flat, none = 0.0 * eye.expand(n_inputs, d, d), torch.zeros(n_inputs, dtype=torch.float64)
        input_stiffness = InputStiffness(flat, flat, InputRange(none, none + float(signed)))
    if k is not None:
        zeros, ones = torch.zeros(k, 2, d, dtype=torch.float64), torch.ones(k, dtype=torch.float64)
        geometry = DecoderGeometry(zeros, zeros[:, 0], eye.expand(k, d, d), ones)
    lagrangian = Lagrangian(
        Coefficients(eye, eye, eye, blank, 0.0 * eye[0], input_stiffness),
        form=FormConfig(**settings["form"]),
        floors=Floors(**settings["floors"]),
        time_unit_s=settings["time_unit_s"],
        seed=0,
        geometry=geometry,
        signed=signed,
        longest_step=settings["longest_step"],
        integrator=settings["integrator"],
    )
    return restore_module(lagrangian, tensors, path), header


def load_parameter_draws(path: Path | str) -> Float64[np.ndarray, "n p"] | None:
    """Read the drawn parameters of a law, or None where its fit had no likelihood."""
    tensors, _ = load_artifact(path, kind=KIND, schema=SCHEMA)
    return tensors.get(DRAWS)


def measure_rest_distance(lagrangian: Lagrangian, trajectory: EncodedTrajectory) -> float:
    """Share of the states of a trajectory that are nearer to their mean than the rest state of a law."""
    mean = trajectory.latents.mean(axis=0)
    distances = np.linalg.norm(trajectory.latents - mean, axis=1)
    return float(np.mean(distances < np.linalg.norm(lagrangian.rest.detach().numpy() - mean)))


def list_extreme_inputs(inputs: Float64[np.ndarray, "T n_u"]) -> Float[Tensor, "n n_u"]:
    """The mean input and all corners of the inputs; each extreme alone where there are many inputs."""
    mean, ends = inputs.mean(axis=0), np.stack([inputs.min(axis=0), inputs.max(axis=0)], axis=1)
    if len(ends) <= MOST_CORNERS:
        corners = [np.array(corner) for corner in product(*ends)]
    else:
        corners = [
            np.where(np.arange(len(mean)) == i, end, mean) for i in range(len(mean)) for end in ends[i]
        ]
    return torch.from_numpy(np.stack([mean, *corners]))


def choose_time_unit(
    trajectory: EncodedTrajectory, metric: Float[np.ndarray, "d d"], *, stride_frames: int
) -> float:
    """Compute the ratio of the rms velocity to the rms acceleration in the metric [s], about a period / 2 pi.

    It uses differences over ``stride_frames`` at their true times. The ratio of position to velocity would be
    the same for a free oscillation, but under a slow drive it becomes the much longer time of the drive.

    Raises:
        ValueError: the latents do not move.
    """
    k = stride_frames
    at = list_starts(trajectory, before=k, after=k)
    q, clock = trajectory.latents, trajectory.clock
    # in strides of the median step
    before, after = (clock.elapsed_s(at, ahead) / (k * clock.dt_s) for ahead in (-k, k))
    moved = clock.slope(q, at, (-k, k)) * (k * clock.dt_s)
    curved = 2.0 * ((q[at + k] - q[at]) / after - (q[at - k] - q[at]) / before) / (after - before)
    speed, change = (float(np.einsum("ti,ij,tj->", x, metric, x)) for x in (moved, curved))
    if not change > 0.0:
        raise ValueError("the latents of the training clip do not move: there is no dynamics to learn")
    return float(np.sqrt(speed / change)) * k * trajectory.dt_s


@dataclass
class BestCheckpoint:
    """The parameters of the best candidate so far and the number of rejected ones."""

    score: float = float("inf")
    state: dict[str, Tensor] = field(default_factory=dict)
    rejected: int = 0

    def consider(self, lagrangian: Lagrangian, score: float) -> None:
        """Keep the parameters if the score is the best so far."""
        if score < self.score:
            self.score = score
            self.state = {k: v.detach().clone() for k, v in lagrangian.state_dict().items()}
        else:
            self.rejected += 1

    def restore(self, lagrangian: Lagrangian) -> None:
        """Put the best parameters back.

        Raises:
            ValueError: no candidate had a finite score.
        """
        if not self.state:
            raise ValueError(
                "every law that was tried leaves the finite numbers on the training clip: take another "
                "stage2.form.mass, or look at latent.png for jumps of the chart"
            )
        lagrangian.load_state_dict(self.state)


CONSTANT_PARTS = ("factor", "stiffness_factor", "pressure_map", "rest", "stiffening", "softening")
CONSTANT_SHARE = 0.1  # share of the learning rate for the parts that start fitted
MOST_CORNERS = 6  # inputs whose extremes are combined


class DynamicsFit:
    """A fit in progress: its data, the law, the best candidate so far and the report; its stages are methods.

    Raises:
        ValueError: segments too short for a window, or latents that do not move.
    """

    lagrangian: Lagrangian  # made by `start` or `maximize_likelihood`
    likelihood: LikelihoodFit  # made by the latter, as the next
    most_likely: FittedLaw

    def __init__(
        self,
        trajectory: EncodedTrajectory,
        metric: Float[np.ndarray, "d d"],
        config: Stage2Config,
        seed: int,
        on_candidate: Callable[[CurveRow], None],
        recall: Recall = solve_anew,
    ) -> None:
        self.recall = recall
        unit = choose_time_unit(trajectory, metric, stride_frames=config.stride_frames)
        self.period_frames = max(4, round(2.0 * np.pi * unit / trajectory.dt_s))
        self.time_unit_s = trajectory.dt_s if config.start.time_unit == "frame" else unit
        bare = torch.from_numpy(metric)
        n_states = round(config.select.periods * self.period_frames) + 1
        starts = config.select.starts
        self.validation = draw_validation_task(trajectory, bare, starts=starts, n_states=n_states)
        self.metric = objective.add_ridge(bare, ridge=config.ridge)
        self.trajectory, self.config, self.seed = trajectory, config, seed
        self.best, self.report = BestCheckpoint(), FitReport(time_unit_s=self.time_unit_s)
        self.rng, self.on_candidate = np.random.default_rng(seed), on_candidate
        self.started_s = time.perf_counter()

    def score_candidate(self, stage: str, step: int, loss: float) -> None:
        """Score the law as it is, keep it if it is the best, and add it to the training curve."""
        self.best.consider(self.lagrangian, self.score_law(stage, self.lagrangian, step, loss).score)

    def score_law(self, stage: str, law: Lagrangian, step: int, loss: float) -> ForecastErrors:
        """Score a law and add it to the training curve."""
        errors = self.validation.measure(law)
        row = CurveRow(stage, step, loss, errors.score, time.perf_counter() - self.started_s)
        self.report.curve.append(row)
        self.on_candidate(row)
        return errors

    def maximize_likelihood(self, measured: EncodedTrajectory) -> None:
        """Find the most likely law of polynomials, and what it says of itself."""
        trajectory, report = self.trajectory, self.report
        weak_form = WeakFormFit(
            measured,
            trajectory,
            self.config.form,
            time_unit_s=self.time_unit_s,
            period_frames=self.period_frames,
            seed=self.seed,
            measure=self.score_law,
            validate=self.validation.measure,
        )
        self.likelihood = LikelihoodFit(weak_form, trajectory, self.config.likelihood, recall=self.recall)
        start = weak_form.choose_start()
        self.most_likely = chosen = self.likelihood.maximize(start)
        report.scores |= {"start": start.errors.score, "likelihood": chosen.errors.score}
        self.lagrangian = lagrangian = chosen.law
        try:
            move_rest_to_equilibrium(lagrangian)
        except NoEquilibriumError as error:
            report.unsettled = str(error)
        if self.config.form.terms == "networks":
            return
        with suppress(np.linalg.LinAlgError, ValueError):  # what nothing determines gets no interval
            report.draws = self.likelihood.draw_laws(chosen)
        if not report.unsettled:
            report.rest_beyond = measure_rest_distance(lagrangian, trajectory)
        report.quietest_hz = measure_quietest_frequency(
            lagrangian, trajectory, period_frames=chosen.period_frames
        )
        inputs = list_extreme_inputs(trajectory.inputs)
        report.equilibria = max(map(len, list_stable_equilibria(lagrangian, inputs)))

    def fit_networks(self, rest: Tensor, geometry: DecoderGeometry | None) -> None:
        """Let networks take over the most likely law, and maximise their likelihood.

        Each stage begins with the best law so far: with an induced mass, networks that learn the
        accelerations of a law of another mass may forecast worse than its constant matrices.
        """
        config, law, form = self.config, self.lagrangian, self.config.form
        near = linearize_law(law, self.trajectory.inputs)
        if form.rest == "fixed":
            near = replace(near, rest=rest)
        if form.actuation == "linear":
            near = replace(near, input_stiffness=None)
        scale = 1.0
        if form.mass == "induced" and geometry is not None:
            _, scale = _mean_induced(geometry, self.trajectory, config.floor.mass)
        stiffness = float(torch.trace(near.stiffness)) / law.d
        floor = config.floor
        self._make_law(
            near,
            Floors(floor.mass, floor.damping, floor.stiffness * stiffness),
            geometry,
            scale,
            law.longest_step,
        )
        iterations = config.likelihood.network_iterations
        self.score_candidate("linearized", 0, float("nan"))
        project = partial(project_law, law, iterations=iterations, seed=self.seed)
        missed = self._recall_fit(lambda networks: project(networks, self.trajectory))
        self.score_candidate("projection", iterations, missed)
        self.report.scores["projection"] = self.best.score
        self.best.restore(self.lagrangian)
        solved = self.likelihood.solve_windows(self.most_likely)
        cost = self._recall_fit(
            lambda networks: fit_networks(networks, law, solved, iterations=iterations).cost
        )
        self.score_candidate("networks", iterations, cost)
        self.report.scores["networks"] = self.best.score
        self.best.restore(self.lagrangian)

    def _recall_fit(self, fit: Callable[[Lagrangian], float]) -> float:
        """Fit the law in place, or take over what an earlier process made of it; what the fit returns."""

        def solve() -> Result:
            left = fit(self.lagrangian)
            return {"left": left, **self.lagrangian.state_dict()}

        told = dict(self.recall(solve))
        left = told.pop("left")
        self.lagrangian.load_state_dict(told)
        return left

    def start(self, rest: Tensor, geometry: DecoderGeometry | None) -> None:
        """Make the Lagrangian, with fitted or isotropic constant parts and networks that are zero."""
        config, floor, inputs = self.config, self.config.floor, self.trajectory.inputs
        mass, scale = None, 1.0
        if config.form.mass == "induced" and geometry is not None:
            mass, scale = _mean_induced(geometry, self.trajectory, floor.mass)
        if config.start.source == "isotropic":
            eye = torch.eye(len(rest), dtype=torch.float64)
            damping, stiffness = config.start.damping * eye, config.start.stiffness * eye
            no_force = torch.zeros(inputs.shape[1], len(rest), dtype=torch.float64)
            start = Coefficients(eye, damping, stiffness, no_force, rest)
            floors = Floors(floor.mass, floor.damping, floor.stiffness * config.start.stiffness)
        else:
            learn_rest = config.form.rest == "learned"
            fit = ConstantFit(rest, inputs.shape[1], floor=floor, learn_rest=learn_rest, mass=mass)
            windows, weight = self._cut_windows(), config.velocity_weight
            fit.minimize(
                lambda c: evaluate_one_step_error(c, windows, self.metric, velocity_weight=weight),
                iterations=config.start.iterations,
            )
            start, floors = fit.result()
        self._make_law(start, floors, geometry, scale, config.longest_step)

    def _make_law(
        self,
        start: Coefficients,
        floors: Floors,
        geometry: DecoderGeometry | None,
        mass_scale: float,
        longest_step: float,
    ) -> None:
        self.lagrangian = Lagrangian(
            start,
            form=self.config.form,
            floors=floors,
            time_unit_s=self.time_unit_s,
            seed=self.seed,
            geometry=geometry,
            mass_scale=mass_scale,
            signed=measure_input_range(self.trajectory.inputs).signed,
            longest_step=longest_step,
            integrator=self.config.integrator,
        )

    def train_on_steps(self) -> None:
        """Train on single velocity-Verlet steps, `Stage2Config.steps` times `Stage2Config.effort` in all."""
        config, steps = self.config, round(self.config.effort * self.config.steps)
        if not steps:
            return
        windows = self._cut_windows()

        def loss() -> Tensor:
            picked = windows.pick(torch.from_numpy(self.rng.integers(0, len(windows), config.batch)))
            weight = config.velocity_weight
            return objective.one_step_error(self.lagrangian, picked, self.metric, velocity_weight=weight)

        self._descend(loss, "one_step", steps, config.lr, config.select.every)

    def _cut_windows(self) -> ShootingWindows:
        stride = self.config.stride_frames
        return list_one_step_windows(self.trajectory, stride_frames=stride, time_unit_s=self.time_unit_s)

    def _descend(self, loss: Callable[[], Tensor], stage: str, steps: int, lr: float, every: int) -> None:
        config, lagrangian = self.config, self.lagrangian
        parameters = [p for p in lagrangian.parameters() if p.requires_grad]
        rollback = StepRollback(parameters)
        optimizer = torch.optim.Adam(_group_parameters(lagrangian, lr), fused=True)
        peaks = [group["lr"] for group in optimizer.param_groups]
        for i in range(steps):
            done = i / steps
            warmup = min(1.0, (done + 1e-3) / 0.05)
            schedule = warmup * decay_by_cosine(done, 1, final=config.final_fraction)
            for group, peak in zip(optimizer.param_groups, peaks, strict=True):
                group["lr"] = peak * (rollback.rate_factor * schedule)
            optimizer.zero_grad()
            value = loss()
            if rollback.accept(float(value.detach())):
                value.backward()
                size = torch.nn.utils.clip_grad_norm_(parameters, config.gradient_clip)
                if torch.isfinite(size):
                    optimizer.step()
                    lagrangian.project()
            else:
                optimizer.state.clear()
            if (i + 1) % every == 0 or i + 1 == steps:
                self.score_candidate(stage, i + 1, float(value.detach()))
        self.report.taken_back += rollback.rollbacks


def _mean_induced(
    geometry: DecoderGeometry, trajectory: EncodedTrajectory, floor: float
) -> tuple[Tensor, float]:
    # energy has no observable scale: a unit mean mass fixes it
    q = torch.from_numpy(trajectory.latents[:: max(1, len(trajectory.latents) // 500)])
    bare = InducedMass(geometry, scale=1.0, floor=0.0).matrix(q).mean(0)
    scale = (1.0 - floor) * bare.shape[0] / float(torch.trace(bare))
    return scale * bare + floor * torch.eye(bare.shape[0], dtype=bare.dtype), scale


def _group_parameters(lagrangian: Lagrangian, lr: float) -> list[dict[str, object]]:
    # the constant parts start at the optimum of a stiff problem, which steps of a network's size would leave
    free = [(name.split(".")[-1], p) for name, p in lagrangian.named_parameters() if p.requires_grad]
    networks = [parameter for name, parameter in free if name not in CONSTANT_PARTS]
    constants = [parameter for name, parameter in free if name in CONSTANT_PARTS]
    return [{"params": networks, "lr": lr}, {"params": constants, "lr": CONSTANT_SHARE * lr}]


EXPLODED = 5.0  # times the median of the recent losses
REMEMBERED = 20  # losses in that median
KEPT_EVERY = 10  # steps between two copies of good parameters
SHORTENED = 0.7  # factor on later steps each time one is taken back


class StepRollback:
    """Rolls a descent back to good parameters when its loss explodes.

    A rollout by explicit steps is unstable when its fastest mode comes near the frame rate. Beyond that limit
    losses are huge and gradients useless, so that the descent cannot return by itself. It is reset and
    continues with shorter steps.
    """

    def __init__(self, parameters: Sequence[Tensor]) -> None:
        self.parameters = parameters
        self.checkpoint = [parameter.detach().clone() for parameter in parameters]
        self.recent: deque[float] = deque(maxlen=REMEMBERED)
        self.accepted = 0
        self.rollbacks = 0

    @property
    def rate_factor(self) -> float:
        """Factor on the learning rate."""
        return SHORTENED**self.rollbacks

    def accept(self, loss: float) -> bool:
        """Return whether the loss is good; if not, reset the parameters to the latest good ones."""
        good = loss < EXPLODED * median(self.recent) if self.recent else loss < float("inf")
        if not good:
            self.rollbacks += 1
            with torch.no_grad():
                for parameter, saved in zip(self.parameters, self.checkpoint, strict=True):
                    parameter.copy_(saved)
            return False
        if self.accepted % KEPT_EVERY == 0:
            self.checkpoint = [parameter.detach().clone() for parameter in self.parameters]
        self.accepted += 1
        self.recent.append(loss)
        return True
