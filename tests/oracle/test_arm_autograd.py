"""The compiled arm against the Euler-Lagrange equations of a finely cut rigid chain, by autograd."""

import math
from pathlib import Path

import numpy as np
import pytest
import torch
from omegaconf import OmegaConf
from scipy.integrate import solve_ivp
from torch.autograd.functional import hessian, jacobian, jvp

from lagsplat.systems.arm import build_arm
from lagsplat.systems.chain import ATMOSPHERE_PA
from lagsplat.systems.config import ArmConfig
from lagsplat.systems.simulate import integrate

PIECES = 400
FOLDER = Path(__file__).resolve().parents[2] / "conf" / "simulation"


@pytest.fixture(scope="module", params=["krauss_1seg", "krauss_2seg"])
def config(request):
    values = OmegaConf.load(FOLDER / f"{request.param}.yaml").arm
    return OmegaConf.to_object(OmegaConf.merge(OmegaConf.structured(ArmConfig), values))


def bodies(q: torch.Tensor, c: ArmConfig) -> tuple[torch.Tensor, list[float], list[float]]:
    """``(right, down, angle)`` of every rigid piece, their masses and rotary inertias."""
    base, angle, found, masses, inertias = (
        torch.zeros(2, dtype=q.dtype),
        torch.zeros((), dtype=q.dtype),
        [],
        [],
        [],
    )
    middle = (torch.arange(PIECES, dtype=q.dtype) + 0.5) / PIECES
    for i, length in enumerate(c.length):
        along = angle + q[2 * i] * middle
        piece = length * (1 + q[2 * i + 1]) / PIECES * torch.stack([along.sin(), along.cos()])
        ends = base[:, None] + torch.cumsum(piece, dim=1)
        found.append(torch.cat([ends - 0.5 * piece, along[None]]))
        masses += [c.mass[i] / PIECES] * PIECES
        inertias += [c.mass[i] / PIECES * c.half_width**2 / 3] * PIECES
        angle = angle + q[2 * i]
        link = c.link_length[i] * torch.stack([angle.sin(), angle.cos()])
        found.append(torch.cat([ends[:, -1] + 0.5 * link, angle[None]])[:, None])
        masses.append(c.link_mass[i])
        inertias.append(c.link_mass[i] * (c.link_length[i] ** 2 / 12 + c.half_width**2 / 3))
        base = ends[:, -1] + link
    return torch.cat(found, dim=1), masses, inertias


def lagrangian(q: torch.Tensor, v: torch.Tensor, pressure: torch.Tensor, c: ArmConfig) -> torch.Tensor:
    place, masses, inertias = bodies(q, c)
    weights = torch.tensor(masses, dtype=q.dtype), torch.tensor(inertias, dtype=q.dtype)
    speed = jvp(lambda x: bodies(x, c)[0], q, v, create_graph=True)[1]
    kinetic = 0.5 * (weights[0] * (speed[0] ** 2 + speed[1] ** 2) + weights[1] * speed[2] ** 2).sum()
    potential = -c.gravity * (weights[0] * place[1]).sum()
    for i, length in enumerate(c.length):
        bend, strain = q[2 * i], q[2 * i + 1]
        k_bend, k_strain = c.bending_stiffness[i], c.extension_stiffness[i]
        potential = potential + k_bend * (bend**2 / 2 + c.bending_hardening * bend**4 / 4)
        potential = potential + k_strain * (strain**2 / 2 + c.extension_hardening * strain**4 / 4)
        for side, sign in enumerate((1, -1)):
            stretch = 1 + strain + sign * c.chamber_offset / length * bend
            bore = c.chamber_area[i] * (c.chamber_limit**2 - stretch**2) / (c.chamber_limit**2 - 1)
            potential = potential - ATMOSPHERE_PA * pressure[2 * i + side] * bore * length * stretch
    return kinetic - potential


def test_acceleration_is_the_euler_lagrange_one(config):
    arm = build_arm(config)
    generator = np.random.default_rng(0)
    for _ in range(4):
        q = generator.uniform(-1, 1, arm.d) * np.tile([1.2, 0.3], arm.d // 2)
        v = generator.uniform(-1, 1, arm.d) * np.tile([6.0, 2.0], arm.d // 2)
        pressure = generator.uniform(0, 0.9, arm.d)
        state = torch.tensor(np.concatenate([q, v]))

        def value(x: torch.Tensor, pressure: np.ndarray = pressure) -> torch.Tensor:
            return lagrangian(x[: arm.d], x[arm.d :], torch.tensor(pressure), config)

        slope = jacobian(value, state)[: arm.d].numpy()
        second = hessian(value, state).numpy()[arm.d :]
        mass, momentum_rate = second[:, arm.d :], second[:, : arm.d] @ v
        damping = config.retardation_s * np.stack(
            [config.bending_stiffness, config.extension_stiffness], axis=1
        )
        expected = np.linalg.solve(mass, slope - momentum_rate - damping.ravel() * v)
        found = arm.acceleration(q, v, pressure)
        np.testing.assert_allclose(found, expected, rtol=1e-4, atol=1e-4 * np.abs(expected).max())


def test_trajectory_agrees_with_another_solver(config):
    """LSODA under pressures written as a formula: bounds the error of solver and spline together."""
    arm, dt_s, n = build_arm(config), 1001 / 60000, 180
    times = np.arange(n) * dt_s
    phase = np.arange(arm.d)

    def pressure(t: float) -> np.ndarray:
        return 0.45 * (1 + np.sin(2 * math.pi * 1.3 * t + phase))

    def rate(t: float, state: np.ndarray) -> np.ndarray:
        q, v = state[: arm.d], state[arm.d :]
        return np.concatenate([v, arm.acceleration(q, v, pressure(t))])

    start = arm.equilibrium(pressure(0.0))
    still = np.zeros(arm.d)
    state = np.concatenate([start, still])
    other = solve_ivp(rate, (0, times[-1]), state, method="LSODA", t_eval=times, rtol=1e-10, atol=1e-12)
    frames = np.stack([pressure(t) for t in times])
    q, v = integrate(arm, start, still, frames, dt_s=dt_s, rtol=1e-8, atol=1e-10)
    # A natural spline is wrong near its ends; the arm forgets most of the resulting push.
    np.testing.assert_allclose(q, other.y[: arm.d].T, atol=2e-4)
    np.testing.assert_allclose(v, other.y[arm.d :].T, atol=2e-2)
