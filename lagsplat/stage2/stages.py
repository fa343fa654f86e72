"""The three stages of a fit, each started from the best candidate before it."""

import math
import time
from collections.abc import Callable
from dataclasses import dataclass, field

import numpy as np
import torch
from torch import Tensor

from lagsplat.chart.trajectory import Trajectory
from lagsplat.stage2.anchor import anchor, anchored
from lagsplat.stage2.config import Stage2Config
from lagsplat.stage2.constant import (
    ConstantFit,
    bent_shooting_error,
    linear_one_step_error,
    linear_shooting_error,
)
from lagsplat.stage2.curvature import reach_of
from lagsplat.stage2.induced import DecoderGeometry, InducedMass
from lagsplat.stage2.lagrangian import Floors, Lagrangian
from lagsplat.stage2.modes import Modes
from lagsplat.stage2.objective import one_step_error, ridged, shooting_error
from lagsplat.stage2.select import Champion, Examination, examination
from lagsplat.stage2.start import isotropic, natural_time_unit
from lagsplat.stage2.undo import Undo
from lagsplat.stage2.windows import Shots, central_velocity, one_step_windows, shots, starts_of

CONSTANT_PARTS = ("factor", "stiffness_factor", "pressure_map", "rest", "stiffening", "softening")
CONSTANT_SHARE = 0.1
"""Of the learning rate, for the parts that start fitted."""
SHORTENED_LEGS = (2, 1)
"""Of the final length of a rollout, which training reaches in as many equal legs."""


@dataclass(frozen=True)
class CurveRow:
    """One line of the training curve."""

    stage: str  # 'start', 'one_step' or 'shooting'
    step: int
    loss: float
    score: float
    seconds: float


@dataclass
class FitReport:
    """What a fit did: the selection score after each stage (rms rollout error over the rms of the training
    clip; the best up to there), the learned physics, and the curve behind them.
    """

    scores: dict[str, float] = field(default_factory=dict)
    curve: list[CurveRow] = field(default_factory=list)
    rejected: int = 0
    taken_back: int = 0  # steps after which the loss exploded
    time_unit_s: float = 0.0
    n_parameters: int = 0
    wall_s: float = 0.0
    at_rest: Modes | None = None
    under_mean_input: Modes | None = None


@dataclass
class Run:
    """What the stages of one fit share."""

    trajectory: Trajectory
    metric: Tensor
    config: Stage2Config
    time_unit_s: float
    period_frames: int
    exam: Examination
    champion: Champion
    report: FitReport
    rng: np.random.Generator
    listen: Callable[[CurveRow], None]
    began: float

    def grade(self, lagrangian: Lagrangian, stage: str, step: int, loss: float) -> None:
        """Score a candidate, keep it if it is the best, and put it on the curve."""
        score = self.exam.score(lagrangian)
        self.champion.consider(lagrangian, score)
        row = CurveRow(stage, step, loss, score, time.perf_counter() - self.began)
        self.report.curve.append(row)
        self.listen(row)

    def stretches(self, at: np.ndarray, *, n_states: int) -> Shots:
        """Rollouts to make from the frames ``at``, with the quieter velocities of training."""
        velocity = central_velocity(self.trajectory, at)
        return shots(self.trajectory, at, velocity, n_states=n_states, time_unit_s=self.time_unit_s)


def open_run(
    trajectory: Trajectory,
    metric: np.ndarray,
    config: Stage2Config,
    seed: int,
    listen: Callable[[CurveRow], None],
) -> Run:
    """Unit of time, metric and examination of a fit."""
    unit = natural_time_unit(trajectory, metric, stride_frames=config.stride_frames)
    period_frames = max(4, round(2.0 * np.pi * unit / trajectory.dt_s))
    bare = torch.from_numpy(metric)
    exam = examination(
        trajectory,
        bare,
        starts=config.select.starts,
        n_states=round(config.select.periods * period_frames) + 1,
    )
    if config.start.time_unit == "frame":
        unit = trajectory.dt_s
    return Run(
        trajectory,
        ridged(bare, ridge=config.ridge),
        config,
        unit,
        period_frames,
        exam,
        Champion(),
        FitReport(time_unit_s=unit),
        np.random.default_rng(seed),
        listen,
        time.perf_counter(),
    )


def start_stage(run: Run, rest: Tensor, seed: int, geometry: DecoderGeometry | None) -> Lagrangian:
    """A Lagrangian whose constant parts are fitted, or isotropic, and whose networks are silent."""
    config, trajectory = run.config, run.trajectory
    d, n_inputs = trajectory.latents.shape[1], trajectory.inputs.shape[1]
    mass, scale = None, 1.0
    if config.form.mass == "induced" and geometry is not None:
        mass, scale = _mean_induced(geometry, trajectory, config.floor.mass)
    if config.start.source == "isotropic":
        start = isotropic(
            d, n_inputs, damping=config.start.damping, stiffness=config.start.stiffness, rest=rest
        )
        floor = config.floor
        floors = Floors(floor.mass, floor.damping, floor.stiffness * config.start.stiffness)
    else:
        fit = ConstantFit(
            rest, n_inputs, floor=config.floor, learn_rest=config.form.rest == "learned", mass=mass
        )
        windows = one_step_windows(
            trajectory, stride_frames=config.stride_frames, time_unit_s=run.time_unit_s
        )
        fit.minimize(
            lambda c: linear_one_step_error(c, windows, run.metric, velocity_weight=config.velocity_weight),
            iterations=config.start.iterations,
        )
        if config.start.shooting_iterations:
            _shoot_constant(run, fit)
        start, floors = fit.result()
    return Lagrangian(
        start,
        form=config.form,
        floors=floors,
        time_unit_s=run.time_unit_s,
        seed=seed,
        geometry=geometry,
        mass_scale=scale,
        signed=reach_of(trajectory.inputs).signed,
        longest_step=config.longest_step,
    )


def _shoot_constant(run: Run, fit: ConstantFit) -> None:
    n_states = _horizon(run, 1.0)
    at = starts_of(run.trajectory, before=2, after=n_states)[:: max(1, n_states // 2)]
    taken = run.stretches(at, n_states=n_states)
    iterations, actuation = run.config.start.shooting_iterations, run.config.form.actuation
    longest = run.config.longest_step
    fit.minimize(
        lambda c: linear_shooting_error(c, taken, run.metric, longest_step=longest), iterations=iterations
    )
    if actuation != "linear" and run.trajectory.inputs.shape[1]:
        fit.bend(reach_of(run.trajectory.inputs), softening=actuation == "bounded", rng=run.rng)
        fit.minimize(
            lambda c: bent_shooting_error(c, taken, run.metric, longest_step=longest), iterations=iterations
        )


def _horizon(run: Run, periods: float) -> int:
    longest = max(b - a for a, b in run.trajectory.segments)
    return max(4, min(round(periods * run.period_frames) + 1, longest - 4))


def _mean_induced(geometry: DecoderGeometry, trajectory: Trajectory, floor: float) -> tuple[Tensor, float]:
    # energy has no observable scale: a unit mean mass fixes it, and the fitted stiffness the frequency
    q = torch.from_numpy(trajectory.latents[:: max(1, len(trajectory.latents) // 500)])
    bare = InducedMass(geometry, scale=1.0, floor=0.0).matrix(q).mean(0)
    scale = (1.0 - floor) * bare.shape[0] / float(torch.trace(bare))
    return scale * bare + floor * torch.eye(bare.shape[0], dtype=bare.dtype), scale


def one_step_stage(run: Run, lagrangian: Lagrangian) -> None:
    """Train on single velocity-Verlet steps, `Stage2Config.steps` times its effort."""
    config, steps = run.config, round(run.config.effort * run.config.steps)
    if not steps:
        return
    windows = one_step_windows(
        run.trajectory, stride_frames=config.stride_frames, time_unit_s=run.time_unit_s
    )

    def loss(step: int) -> Tensor:
        pick = torch.from_numpy(run.rng.integers(0, len(windows), config.batch))
        return one_step_error(
            lagrangian, windows.pick(pick), run.metric, velocity_weight=config.velocity_weight
        )

    _descend(run, lagrangian, loss, "one_step", steps=steps, lr=config.lr, every=config.select.every)


def shooting_stage(run: Run, lagrangian: Lagrangian) -> None:
    """Train the best candidate so far on rollouts, whose length doubles up to `ShootConfig.periods`.

    The batch halves meanwhile. A step costs much the same, and each leg starts where the one before it has
    the fast part of the law right.
    """
    shoot, total = run.config.shoot, round(run.config.effort * run.config.shoot.steps)
    if not total:
        return
    run.champion.restore(lagrangian)
    held = anchor(lagrangian, run.trajectory) if shoot.anchor else None
    for leg, shortened in enumerate(SHORTENED_LEGS):
        n_states = _horizon(run, shoot.periods / shortened)
        starts = starts_of(run.trajectory, before=2, after=n_states)
        batch = shoot.batch * shortened

        def loss(_: int, starts: np.ndarray = starts, batch: int = batch, n_states: int = n_states) -> Tensor:
            taken = run.stretches(run.rng.choice(starts, batch), n_states=n_states)
            error = shooting_error(lagrangian, taken, run.metric)
            if held is None:
                return error
            price = held.price(lagrangian, run.metric, run.rng)
            return anchored(error, price, weight=shoot.anchor)

        steps = total * (leg + 1) // len(SHORTENED_LEGS) - total * leg // len(SHORTENED_LEGS)
        if steps:
            _descend(run, lagrangian, loss, "shooting", steps=steps, lr=shoot.lr, every=max(1, steps // 10))


def _descend(
    run: Run,
    lagrangian: Lagrangian,
    loss: Callable[[int], Tensor],
    stage: str,
    *,
    steps: int,
    lr: float,
    every: int,
) -> None:
    config = run.config
    parameters = [p for p in lagrangian.parameters() if p.requires_grad]
    undo = Undo(parameters)
    optimizer = torch.optim.Adam(_rates(lagrangian, lr), fused=True)
    peaks = [group["lr"] for group in optimizer.param_groups]
    for i in range(steps):
        factor = undo.shortening * _schedule(i / steps, final_fraction=config.final_fraction)
        for group, peak in zip(optimizer.param_groups, peaks, strict=True):
            group["lr"] = peak * factor
        optimizer.zero_grad()
        value = loss(i)
        if undo.accepts(float(value.detach())):
            value.backward()
            size = torch.nn.utils.clip_grad_norm_(parameters, config.gradient_clip)
            if torch.isfinite(size):
                optimizer.step()
                lagrangian.project()
        else:
            optimizer.state.clear()
        if (i + 1) % every == 0 or i + 1 == steps:
            run.grade(lagrangian, stage, i + 1, float(value.detach()))
    run.report.taken_back += undo.taken_back


def _rates(lagrangian: Lagrangian, lr: float) -> list[dict[str, object]]:
    # the constant parts start at the optimum of a stiff problem, where steps fit for a network throw them off
    parts: dict[bool, list[Tensor]] = {True: [], False: []}
    for name, parameter in lagrangian.named_parameters():
        if parameter.requires_grad:
            parts[name.split(".")[-1] in CONSTANT_PARTS].append(parameter)
    return [{"params": parts[False], "lr": lr}, {"params": parts[True], "lr": CONSTANT_SHARE * lr}]


def _schedule(progress: float, *, final_fraction: float) -> float:
    warm = min(1.0, (progress + 1e-3) / 0.05)
    cosine = 0.5 * (1.0 + math.cos(math.pi * progress))
    return warm * (final_fraction + (1.0 - final_fraction) * cosine)
