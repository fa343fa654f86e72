"""Fits constant positive definite M, C, K and linear chamber volumes to single steps, in seconds.

A step costs a few matrix products, so that L-BFGS can make hundreds of passes over the clip. Steps of equal
length are one linear map.
"""

from collections.abc import Callable

import numpy as np
import torch
from jaxtyping import Float
from scipy.optimize import minimize
from torch import Tensor

from lagsplat.array_types import Metric, Scalar
from lagsplat.stage2.config import FloorConfig
from lagsplat.stage2.lagrangian import Coefficients, Floors
from lagsplat.stage2.objective import window_error
from lagsplat.stage2.rollout import ShootingWindows

UNUSABLE = 1e6  # objective of a candidate whose rollouts overflow, as a multiple of the first objective


class ConstantFit:
    """The unknowns of a constant system and their fit to an objective.

    Energy has no observable scale, so M has mean eigenvalue 1 unless a fixed ``mass`` is given. The floors
    are relative to it and to the mean eigenvalue of K. ``rest`` is the first rest state, or the fixed one.
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
        self.shapes = {name: value.shape for name, value in first.items()}
        self.flat = torch.cat([value.reshape(-1) for value in first.values()]).numpy()
        self.rest, self.floor, self.learn_rest, self.mass = rest, floor, learn_rest, mass

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
        coefficients = Coefficients(
            mass=unit if self.mass is None else self.mass,
            damping=_square(part["damping"]) + floor.damping * eye,
            stiffness=elastic + stiffness_floor * eye,
            pressure_map=part["map"],
            rest=part["rest"] if self.learn_rest else self.rest,
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
        q, v = _take_step(c, windows, h)
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


def _take_step(c: Coefficients, w: ShootingWindows, h: Tensor) -> tuple[Tensor, Tensor]:
    """The velocity-Verlet steps of windows that differ in length."""
    inverse, drive = torch.linalg.inv(c.mass), w.u @ c.pressure_map

    def accelerate(q: Tensor, v: Tensor) -> Tensor:
        return (drive - (q - c.rest) @ c.stiffness - v @ c.damping) @ inverse

    first = accelerate(w.q, w.v)
    q = w.q + h * (w.v + 0.5 * h * first)
    return q, w.v + 0.5 * h * (first + accelerate(q, w.v + h * first))
