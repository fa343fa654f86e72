"""Oscillators whose every force is written down here, moved by scipy, and the bench they are held against."""

from collections.abc import Callable, Sequence
from functools import cache

import numpy as np
from scipy.integrate import solve_ivp

from lagsplat.config.compose import compose
from lagsplat.diagnose.augmented.model import AugmentedSimulator
from lagsplat.diagnose.core.config import DiagnoseConfig
from lagsplat.diagnose.effects.base import PlacedEffect
from lagsplat.diagnose.estimation.dataset import OperatingRegion
from lagsplat.diagnose.estimation.nuisance import NuisanceParameters
from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator
from lagsplat.diagnose.inference.problem import EstimationProblem, build_problem
from lagsplat.diagnose.mechanics.basis import add_angle_functions, make_polynomial_basis
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.mechanics.structure import flatten_coefficients
from lagsplat.io.trajectory.trajectory import Trajectory

OMEGA, RATE, GAIN = 2.0 * np.pi, 0.3, 8.0
"""Natural angular frequency [1/s], damping rate [1/s] and gain of the input of the oscillator."""
HARD = 6.0
"""Its cubic stiffness [1/s^2]."""


def oscillator(*, n_u: int = 1, hard: float = HARD) -> MechanicalModel:
    """``a = -omega^2 q - hard q^3 - rate v + gain u``."""
    basis = make_polynomial_basis(4, centre=np.zeros(1), scale=np.ones(1))
    return MechanicalModel(
        basis=basis,
        mass=np.ones((1, 1, 1)),
        damping=np.full((1, 1, 1), RATE),
        potential=np.array([0.0, 0.0, 0.5 * OMEGA**2, 0.0, 0.25 * hard]),
        input_map=np.full((1, n_u, 1), GAIN),
        dry=np.zeros(1),
        drag=np.zeros(1),
        width=np.full(1, 0.05),
        rest=np.zeros(1),
    )


def wave(seed: int = 0) -> Callable[[float], float]:
    """A smooth input of rms one or so, between a fifth and twice the natural frequency."""
    rng = np.random.default_rng(seed)
    hertz, phase = rng.uniform(0.2, 2.0, 5), rng.uniform(0.0, 2.0 * np.pi, 5)
    return lambda t: float(0.63 * np.sin(2.0 * np.pi * hertz * t + phase).sum())


def own(q: float, v: float, u: float, *, hard: float = HARD) -> float:
    """Acceleration of the oscillator."""
    return -(OMEGA**2) * q - hard * q**3 - RATE * v + GAIN * u


Law = Callable[[float, float, float, float, np.ndarray], tuple[float, list[float]]]
"""From ``t, q, v, u`` and memories to the whole acceleration and the memories' rates."""


def plain(t: float, q: float, v: float, u: float, z: np.ndarray) -> tuple[float, list[float]]:
    """The oscillator itself."""
    return own(q, v, u), []


def film(
    law: Law = plain,
    *,
    seconds: float = 12.0,
    start: Sequence[float] = (0.8, 0.0),
    u: Callable[[float], float] | None = None,
    command: Callable[[float], float] | None = None,
    noise: float = 0.0,
    seed: int = 0,
    rate_hz: float = 50.0,
    max_step: float = 0.02,
) -> Trajectory:
    """The motion of ``law`` from ``start`` (q, v, memories ...); ``command`` is the input by the log."""
    times = np.arange(round(seconds * rate_hz)) / rate_hz
    push = u or (lambda t: 0.0)

    def rate(t: float, x: np.ndarray) -> list[float]:
        a, further = law(t, x[0], x[1], push(t), x[2:])
        return [x[1], a, *further]

    solved = solve_ivp(
        rate, (0.0, times[-1]), list(start), t_eval=times, rtol=1e-7, atol=1e-9, max_step=max_step
    )
    q = solved.y[:1].T
    q = q + noise * q.std() * np.random.default_rng(seed).standard_normal(q.shape)
    logged = command or u
    inputs = np.array([[logged(t)] for t in times]) if logged else np.zeros((len(times), 0))
    return Trajectory(time_s=times, q=q, u=inputs, source=f"film {seed}")


@cache
def settings() -> DiagnoseConfig:
    """The settings as they come."""
    return compose().diagnose


def contest(real: Sequence[Trajectory], *, model: MechanicalModel | None = None) -> EstimationProblem:
    """The contest of an exactly known oscillator with ``real``."""
    known = model or oscillator(n_u=real[0].n_u)
    return build_problem(EstimatedSimulator.exact(known), real, settings())


def coupled() -> MechanicalModel:
    """Two coordinates with inertia that depends on them, every kind of friction and two inputs."""
    basis = add_angle_functions(
        make_polynomial_basis(2, centre=np.zeros(2), scale=np.full(2, 0.8)),
        np.array([[1, 0], [0, 1], [1, -1]]),
    )
    mass = np.zeros((basis.size, 2, 2))
    mass[0] = [[2.0, 0.2], [0.2, 1.0]]
    mass[8] = [[0.0, 0.4], [0.4, 0.0]]  # cos(q0 - q1)
    potential = np.zeros(basis.size)
    potential[6:9] = -12.0, -7.0, -1.5  # minus the cosines
    damping = np.zeros((3, 2, 2))
    damping[0] = [[0.5, -0.1], [-0.1, 0.3]]
    damping[1, 0, 0] = 0.1
    input_map = np.zeros((3, 2, 2))
    input_map[0] = [[6.0, 0.0], [1.0, 4.0]]
    input_map[2, 0] = [0.5, 0.5]
    return MechanicalModel(
        basis=basis,
        mass=mass,
        damping=damping,
        potential=potential,
        input_map=input_map,
        dry=np.array([0.1, 0.0]),
        drag=np.array([0.0, 0.05]),
        width=np.full(2, 0.05),
        rest=np.zeros(2),
    )


def bare(
    model: MechanicalModel, region: OperatingRegion, *, step_s: float, dt_s: float
) -> AugmentedSimulator:
    """A model as an augmented simulator to which nothing is added yet."""
    no_moves = np.zeros((0, flatten_coefficients(model).size))
    nothing = NuisanceParameters(*[1.0] * 4, np.ones(model.d), 1.0, model.n_u, no_moves)
    names = (tuple(f"{kind}{i}" for i in range(n)) for kind, n in (("q", model.d), ("u", model.n_u)))
    return AugmentedSimulator(
        model, nothing, (), np.zeros(nothing.size), False, step_s, dt_s, *names, region=region
    )


def name_place(placed: PlacedEffect) -> str:
    """The effect and where it acts."""
    everywhere = "everywhere" if placed.parts else None
    return " ".join(p for p in (placed.effect.name, placed.location, placed.variant, everywhere) if p)
