"""Fits constant positive definite M, C, K and chamber volumes of first or second order, in seconds.

The fit starts with the one-step objective, which is nearly convex. Rollouts of one natural period follow,
which show the slow drift that one step hides, and last, the curvatures of the volumes. A step costs a few
matrix products, so that L-BFGS can make hundreds of passes over the clip. Steps of equal length are one
linear map.
"""

import math
from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float
from scipy.optimize import minimize
from torch import Tensor

from lagsplat.array_types import Metric, Scalar
from lagsplat.stage2.config import FloorConfig
from lagsplat.stage2.input_stiffness import InputRange, InputStiffness, stiffen, stiffness_penalty
from lagsplat.stage2.lagrangian import Coefficients, Floors
from lagsplat.stage2.objective import square_norm, window_error
from lagsplat.stage2.rollout import ShootingTargets, ShootingWindows, Step, choose_step, split_inputs

FAST_RATE_WEIGHT = 1e-2
"""Weight of ``|h M^-1 C|^2`` relative to a shooting error of 1; it keeps decay rates below the
frame rate, above which an explicit step is stable only by chance."""
BEND_WEIGHT = 1e-4
"""Weight of ``sum_c |M^-1 u_max,c Q_c|^2`` in the same way; it keeps unidentified curvatures small and the
problem well conditioned."""
FIRST_BEND = 0.05
"""Standard deviation of the initial factors of the curvatures; at zero they would have no gradient."""
UNUSABLE = 1e6  # objective of a candidate whose rollouts overflow, as a multiple of the first objective


class ConstantFit:
    """The unknowns of a constant system and their fit to an objective.

    Energy has no observable scale, so M has mean eigenvalue 1 unless a fixed ``mass`` is given. The floors
    are relative to it and to the mean eigenvalue of K. ``rest`` is the first rest state, or the fixed one.
    The volumes are linear until `add_input_stiffness`.
    """

    def __init__(
        self,
        rest: Float[Tensor, " d"],
        n_inputs: int,
        *,
        floor: FloorConfig,
        learn_rest: bool,
        mass: Float[Tensor, "d d"] | None = None,
    ) -> None:
        d = rest.shape[0]
        eye = torch.eye(d, dtype=torch.float64)
        first = {"mass": eye, "damping": 0.5 * eye, "stiffness": eye}
        first |= {"map": torch.zeros(n_inputs, d, dtype=torch.float64), "rest": rest}
        first |= {
            "stiffening": 0.0 * eye.expand(n_inputs, d, d),
            "softening": 0.0 * eye.expand(n_inputs, d, d),
        }
        self.input_range: InputRange | None = None
        self.softens = False
        self.shapes = {name: value.shape for name, value in first.items()}
        self.flat = torch.cat([value.reshape(-1) for value in first.values()]).numpy()
        self.rest, self.floor, self.learn_rest, self.mass = rest, floor, learn_rest, mass

    def add_input_stiffness(
        self, input_range: InputRange, *, softening: bool, rng: np.random.Generator
    ) -> None:
        """Add curvatures of the volumes to the unknowns; ``softening`` also allows inputs that soften."""
        self.input_range, self.softens = input_range, softening
        n_curvatures = sum(self.shapes[name].numel() for name in ("stiffening", "softening"))
        self.flat = self.flat.copy()
        self.flat[-n_curvatures:] = FIRST_BEND * rng.standard_normal(n_curvatures)

    def coefficients(self, flat: Float[Tensor, " n"]) -> tuple[Coefficients, Floors]:
        """Convert the vector of unknowns to matrices and their floors."""
        pieces = flat.split([shape.numel() for shape in self.shapes.values()])
        part = {n: p.view(s) for (n, s), p in zip(self.shapes.items(), pieces, strict=True)}
        d, floor = self.rest.shape[0], self.floor
        eye = torch.eye(d, dtype=torch.float64)
        free = _square(part["mass"])
        unit = (free * (d / torch.trace(free)) + floor.mass * eye) / (1.0 + floor.mass)
        elastic = _square(part["stiffness"])
        stiffness_floor = floor.stiffness * torch.trace(elastic) / d
        stiffness, input_stiffness = elastic + stiffness_floor * eye, None
        if self.input_range is not None:
            stiffer, softer = _square(part["stiffening"]), _square(part["softening"]) * float(self.softens)
            stiffness = stiffness + stiffness_penalty(softer, self.input_range.positive)
            stiffness = stiffness + stiffness_penalty(stiffer, self.input_range.negative)
            input_stiffness = InputStiffness(stiffer, softer, self.input_range)
        coefficients = Coefficients(
            mass=unit if self.mass is None else self.mass,
            damping=_square(part["damping"]) + floor.damping * eye,
            stiffness=stiffness,
            pressure_map=part["map"],
            rest=part["rest"] if self.learn_rest else self.rest,
            input_stiffness=input_stiffness,
        )
        floors = Floors(floor.mass / (1.0 + floor.mass), floor.damping, float(stiffness_floor.detach()))
        return coefficients, floors

    def minimize(self, objective: Callable[[Coefficients], Tensor], *, iterations: int) -> float:
        """Minimise ``objective`` by full-batch L-BFGS from the present unknowns; return its value."""

        def loss_and_slope(flat: np.ndarray) -> tuple[float, np.ndarray]:
            variable = torch.from_numpy(flat).requires_grad_()
            error = objective(self.coefficients(variable)[0])
            (slope,) = torch.autograd.grad(error, variable)
            if not (torch.isfinite(error) and torch.isfinite(slope).all()):
                return UNUSABLE, np.zeros_like(flat)
            return float(error.detach()) / scale, slope.numpy() / scale

        scale = 1.0
        scale = max(loss_and_slope(self.flat)[0], 1e-300)
        limits = {"maxiter": iterations, "maxfun": 2 * iterations, "maxcor": 30, "ftol": 1e-12, "gtol": 1e-9}
        optimum = minimize(loss_and_slope, self.flat, jac=True, method="L-BFGS-B", options=limits)
        self.flat = optimum.x
        return float(optimum.fun) * scale

    def result(self) -> tuple[Coefficients, Floors]:
        """The fitted matrices and their floors."""
        with torch.no_grad():
            return self.coefficients(torch.from_numpy(self.flat))


def _square(part: Tensor) -> Tensor:
    lower = torch.tril(part)
    return lower @ lower.mT


def evaluate_one_step_error(
    c: Coefficients, windows: ShootingWindows, metric: Metric, *, velocity_weight: float
) -> Scalar:
    """Compute `objective.one_step_error` of a constant system without a solve per sample.

    Source: paper eq. (physics_loss).
    """
    d, h = metric.shape[0], windows.step
    if isinstance(h, Tensor):
        q, v = _ConstantLaw(c).step(windows.q, windows.v, windows.u, windows.u @ c.pressure_map, h)
    else:
        transition, entry = assemble_step_matrices(c, h)
        push = (windows.u @ c.pressure_map + c.rest @ c.stiffness) @ torch.linalg.inv(c.mass)
        state = torch.cat([windows.q, windows.v], 1) @ transition + push @ entry
        q, v = state.split(d, 1)
    return window_error(windows, q, v, metric, velocity_weight=velocity_weight)


def assemble_step_matrices(c: Coefficients, h: float) -> tuple[Float[Tensor, "s s"], Float[Tensor, "d s"]]:
    """F and P of a velocity-Verlet step ``h``: ``(q, v) @ F + p @ P`` with ``p = M^-1 (force + K rest)``."""
    inverse = torch.linalg.inv(c.mass)
    stiff, damp = c.stiffness @ inverse, c.damping @ inverse
    eye = torch.eye(damp.shape[0], dtype=damp.dtype)
    half_q, half_v, half_p = -0.5 * h * stiff, eye - 0.5 * h * damp, 0.5 * h * eye
    end_q, end_v, end_p = -h * stiff, eye - h * damp, h * eye
    q_q, q_v, q_p = eye + h * half_q, h * half_v, h * half_p
    v_q = half_q - 0.5 * h * (q_q @ stiff + end_q @ damp)
    v_v = half_v - 0.5 * h * (q_v @ stiff + end_v @ damp)
    v_p = half_p - 0.5 * h * (q_p @ stiff + end_p @ damp) + 0.5 * h * eye
    transition = torch.cat([torch.cat([q_q, v_q], 1), torch.cat([q_v, v_v], 1)], 0)
    return transition, torch.cat([q_p, v_p], 1)


def evaluate_shooting_error(
    c: Coefficients, shots: ShootingTargets, metric: Metric, *, longest_step: float = math.inf
) -> Scalar:
    """Compute `objective.shooting_error` of a constant system plus its small penalties.

    Steps of equal length of a linear system are one matrix; others are taken one by one.
    """
    d = metric.shape[0]
    if isinstance(shots.steps, Tensor) or c.input_stiffness is not None:
        return _add_penalties(_roll_out(c, shots, longest_step), c, shots, metric)
    pieces = split_inputs(shots.steps, longest_step)
    step_transition, step_entry = assemble_step_matrices(c, shots.steps / pieces)
    transition, entry = step_transition, step_entry
    for _ in range(pieces - 1):
        transition, entry = transition @ step_transition, entry @ step_transition + step_entry
    inverse = torch.linalg.inv(c.mass)
    force = shots.inputs[:, :-1] @ c.pressure_map + c.rest @ c.stiffness
    drive = force @ (inverse @ entry)
    state = torch.cat([shots.q, shots.v], 1)
    path = []
    for i in range(drive.shape[1]):
        state = torch.addmm(drive[:, i], state, transition)
        path.append(state)
    return _add_penalties(torch.stack(path, 1)[:, :, :d], c, shots, metric)


def _roll_out(c: Coefficients, shots: ShootingTargets, longest_step: float) -> Float[Tensor, "B n d"]:
    """Roll out the states after the first, step by step."""
    law = _ConstantLaw(c)
    q, v, path = shots.q, shots.v, []
    drive = shots.inputs @ c.pressure_map
    for i in range(shots.targets.shape[1] - 1):
        step = choose_step(shots.steps, i)
        pieces = split_inputs(step, longest_step)
        for _ in range(pieces):
            q, v = law.step(q, v, shots.inputs[:, i], drive[:, i], step / pieces)
        path.append(q)
    return torch.stack(path, 1)


class _ConstantLaw:
    """Velocity-Verlet steps of a constant system, with the terms that all steps share."""

    def __init__(self, c: Coefficients) -> None:
        self.c, self.inverse = c, torch.linalg.inv(c.mass)
        self.curvature = None if c.input_stiffness is None else c.input_stiffness.curvature

    def step(self, q: Tensor, v: Tensor, u: Tensor, drive: Tensor, step: Step) -> tuple[Tensor, Tensor]:
        first = self._acceleration(q, v, u, drive)
        q = q + step * (v + 0.5 * step * first)
        return q, v + 0.5 * step * (first + self._acceleration(q, v + step * first, u, drive))

    def _acceleration(self, q: Tensor, v: Tensor, u: Tensor, drive: Tensor) -> Tensor:
        offset = q - self.c.rest
        elastic = offset @ self.c.stiffness
        if self.curvature is not None:
            elastic = elastic + stiffen(u, self.curvature, offset)
        return (drive - elastic - v @ self.c.damping) @ self.inverse


def _add_penalties(path: Tensor, c: Coefficients, shots: ShootingTargets, metric: Metric) -> Scalar:
    targets, d = shots.targets[:, 1:], metric.shape[0]
    inverse = torch.linalg.inv(c.mass)
    step = shots.steps.mean() if isinstance(shots.steps, Tensor) else shots.steps
    fast = (step * c.damping @ inverse).square().sum()
    spread = square_norm(targets - shots.targets.mean((0, 1)), metric).mean() / d
    penalty = FAST_RATE_WEIGHT * fast
    if c.input_stiffness is not None:
        ends = c.input_stiffness.input_range
        largest = torch.maximum(ends.positive, ends.negative)
        loaded = inverse @ (largest[:, None, None] * c.input_stiffness.curvature)
        penalty = penalty + BEND_WEIGHT * loaded.square().sum()
    return square_norm(path - targets, metric).mean() / d + spread * penalty
