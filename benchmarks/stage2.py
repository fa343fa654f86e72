"""Cost of stage 2 on two cores: one Adam step of the full protocol, and a 50-rollout evaluation.

Run as ``python benchmarks/stage2.py``. The comparison is with the same step whose forces are taken by
automatic differentiation of the energies, sample by sample vectorised, in the same process. Rollouts of a law
of polynomials are compared with the same rollouts by torch.
"""

import time
from collections.abc import Callable

import torch
from torch import Tensor

from lagsplat.config.compose import compose
from lagsplat.monomials import make_wide_ball
from lagsplat.stage2.config import Degrees, FormConfig
from lagsplat.stage2.input_stiffness import InputRange, InputStiffness
from lagsplat.stage2.lagrangian import Coefficients, Floors, Lagrangian
from lagsplat.stage2.objective import one_step_error
from lagsplat.stage2.rollout import ShootingWindows, rollout, rollout_in_torch

D, N_INPUTS, BATCH, STEPS = 4, 4, 32, 47_000


def published_size() -> Lagrangian:
    eye = torch.eye(D, dtype=torch.float64)
    form = FormConfig(
        mass="learned",
        damping="learned",
        potential="invex",
        actuation="bounded",
        rest="learned",
        matrix_width=64,
        potential_width=64,
        actuation_width=32,
        diffeo_blocks=2,
        diffeo_width=64,
        diffeo_lipschitz=0.9,
        terms="networks",
        potential_degree=None,
        input_degree=1,
        matrix_degree=None,
        map_degree=None,
    )
    ones = torch.ones(N_INPUTS, D, dtype=torch.float64)
    curvature = 0.1 * eye.expand(N_INPUTS, D, D)
    input_stiffness = InputStiffness(curvature, 0.0 * curvature, InputRange(ones[:, 0], 0.0 * ones[:, 0]))
    start = Coefficients(eye, 0.2 * eye, eye, ones, 0.0 * eye[0], input_stiffness)
    return Lagrangian(start, form=form, floors=Floors(1e-2, 1e-3, 1e-2), time_unit_s=0.1, seed=0)


def polynomial_law() -> Lagrangian:
    eye = torch.eye(D, dtype=torch.float64)
    form = FormConfig(**vars(compose("system=krauss_2seg").stage2.form))
    form = form.with_degrees(Degrees(potential=4, inputs=3, coordinates=2, matrices=1))
    force = 0.1 * torch.ones(N_INPUTS, D, dtype=torch.float64)
    start = Coefficients(eye, 0.2 * eye, eye, force, 0.0 * eye[0])
    ball = make_wide_ball(D, 3.0)
    return Lagrangian(start, form=form, floors=Floors(1e-2, 1e-3, 0.0), time_unit_s=0.1, seed=0, ball=ball)


def seconds(action: Callable[[], object], repeats: int) -> float:
    action()
    began = time.perf_counter()
    for _ in range(repeats):
        action()
    return (time.perf_counter() - began) / repeats


def autograd_acceleration(lagrangian: Lagrangian, q: Tensor, v: Tensor, u: Tensor) -> Tensor:
    q = q if q.requires_grad else q.detach().requires_grad_()
    mass = lagrangian.mass(q)
    momentum = (mass @ v[:, :, None])[:, :, 0]
    action = 0.5 * (momentum * v).sum() - lagrangian.potential(q).sum() + (lagrangian.volume(q) * u).sum()
    (gradient,) = torch.autograd.grad(action, q, create_graph=True)
    rows = [torch.autograd.grad(momentum[:, i].sum(), q, create_graph=True)[0] for i in range(D)]
    change = (torch.stack(rows, 1) @ v[:, :, None])[:, :, 0]
    force = gradient - change - (lagrangian.damping(q) @ v[:, :, None])[:, :, 0]
    return torch.linalg.solve(mass, force)


def time_parts() -> dict[str, float]:
    """Seconds of a step of Adam, of the same by automatic gradients, and of rollouts."""
    # the tensors are too small to share: a second thread costs more than it computes
    torch.set_num_threads(1)
    torch.manual_seed(0)
    lagrangian = published_size()
    parameters = [p for p in lagrangian.parameters() if p.requires_grad]
    optimizer = torch.optim.Adam(parameters, 1e-4, fused=True)
    q, v, q_next, v_next = torch.randn(4, BATCH, D, dtype=torch.float64)
    u = torch.rand(BATCH, N_INPUTS, dtype=torch.float64)
    windows = ShootingWindows(q=q, v=v, u=u, q_next=q_next, v_next=v_next, step=0.1)
    metric = torch.eye(D, dtype=torch.float64)

    def descend(error: Callable[[], Tensor]) -> None:
        optimizer.zero_grad()
        error().backward()
        torch.nn.utils.clip_grad_norm_(parameters, 100.0)
        optimizer.step()
        lagrangian.project()

    def by_autograd() -> Tensor:
        half = v + 0.05 * autograd_acceleration(lagrangian, q, v, u)
        ahead = q + 0.1 * half
        last = half + 0.05 * autograd_acceleration(lagrangian, ahead, half, u)
        return ((ahead - q_next) ** 2).mean() + ((last - v_next) ** 2).mean()

    start = torch.randn(2, 50, D, dtype=torch.float64)
    drive = torch.rand(50, 30, N_INPUTS, dtype=torch.float64)
    law, slow, longer = polynomial_law(), 0.3 * start, drive.repeat(1, 2, 1)
    return {
        "step": seconds(
            lambda: descend(lambda: one_step_error(lagrangian, windows, metric, velocity_weight=1.0)), 50
        ),
        "automatic": seconds(lambda: descend(by_autograd), 20),
        "rollouts": seconds(lambda: rollout(lagrangian, 0.1 * start[0], start[1], drive, dt_s=0.0167), 3),
        "by torch": seconds(lambda: rollout_in_torch(law, slow[0], slow[1], longer, dt_s=0.0167), 3),
        "compiled": seconds(lambda: rollout(law, slow[0], slow[1], longer, dt_s=0.0167), 3),
    }


def main() -> None:
    taken = time_parts()
    step, compiled = taken["step"], taken["compiled"]
    print(f"one Adam step of {BATCH} windows   {1e3 * step:8.2f} ms")
    print(
        f"the same by automatic gradients {1e3 * taken['automatic']:8.2f} ms   "
        f"ratio {taken['automatic'] / step:.1f}"
    )
    print(f"{STEPS} steps                     {step * STEPS / 60:8.1f} min  (mark: 8)")
    print(f"50 rollouts of 30 states        {taken['rollouts']:8.3f} s    (mark: 5)")
    slower = taken["by torch"] / compiled
    print(f"50 of 60 states, polynomials    {compiled:8.3f} s    by torch {slower:.0f} times as long")


if __name__ == "__main__":
    main()
