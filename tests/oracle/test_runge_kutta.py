"""Rollouts against scipy and against the Lagrangian differentiated by complex steps."""

import math
from collections.abc import Callable
from dataclasses import replace
from itertools import pairwise

import numpy as np
import pytest
from scipy.integrate import solve_ivp

from lagsplat.diagnose.effects.base import Direction, PlacedEffect
from lagsplat.diagnose.effects.parameters import Scales
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.estimation.dataset import Dataset, WindowSet
from lagsplat.diagnose.estimation.nuisance import NuisanceParameters
from lagsplat.diagnose.estimation.rollout import RolloutModel
from lagsplat.diagnose.mechanics.basis import Basis, add_angle_functions, make_polynomial_basis
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.solvers.dry_friction import PRESLIDING_SHARE
from lagsplat.diagnose.solvers.runge_kutta import DIVERGED_SCALES

UNIT = Scales(coordinate=1.0, velocity=1.0, reach=1.0, frame_s=0.02, duration_s=1.0, stiffness=30.0)
"""With these a parameter is its own unknown, or the exponential of it, unless it is an acceleration."""


def wild(d: int, n_u: int, seed: int = 0) -> MechanicalModel:
    """Every field depends on the coordinates, and every kind of loss is there."""
    rng = np.random.default_rng(seed)
    multiples = [np.eye(d, dtype=np.int64)]
    if d > 1:
        difference = np.zeros((1, d), dtype=np.int64)
        difference[0, :2] = 1, -2
        multiples.append(difference)
    basis = add_angle_functions(
        make_polynomial_basis(
            3 if d < 4 else 2, centre=rng.normal(0.0, 0.1, d), scale=rng.uniform(0.7, 1.3, d)
        ),
        np.concatenate(multiples),
    )

    def symmetric(size: int, scale: float) -> np.ndarray:
        a = scale * rng.normal(size=(size, d, d))
        return a + a.transpose(0, 2, 1)

    mass = symmetric(basis.size, 0.02)
    mass[0] += (1.0 + d) * np.eye(d)
    damping = symmetric(d + 1, 0.02)
    damping[0] += 0.5 * np.eye(d)
    potential = 0.3 * rng.normal(size=basis.size)
    for i in range(d):
        square = np.flatnonzero((basis.kind == 0) & (basis.order[:, i] == 2) & (basis.order.sum(axis=1) == 2))
        potential[square] += 15.0 * (1.0 + d)
    return MechanicalModel(
        basis=basis,
        mass=mass,
        damping=damping,
        potential=potential,
        input_map=rng.normal(0.0, 4.0, (d + 1, n_u, d)),
        dry=np.zeros(d),
        drag=rng.uniform(0.05, 0.2, d),
        width=np.full(d, 0.3),
        rest=rng.normal(0.0, 0.05, d),
    )


def functions(basis: Basis, q: np.ndarray) -> np.ndarray:
    """The basis, written anew for complex coordinates."""
    x = (q - basis.centre) / basis.scale
    rows = []
    for kind, order in zip(basis.kind, basis.order, strict=True):
        angle = (order * q).sum()
        rows.append((x**order).prod() if kind == 0 else np.cos(angle) if kind == 1 else np.sin(angle))
    return np.array(rows)


def accelerate(
    model: MechanicalModel,
    q: np.ndarray,
    v: np.ndarray,
    u: np.ndarray,
    further: Callable[[np.ndarray, np.ndarray], np.ndarray],
) -> np.ndarray:
    """Lagrange's equations, differentiated by complex steps; ``further`` adds to what spring and drive do."""
    d, h = model.d, 1e-30

    def inertia(x: np.ndarray) -> np.ndarray:
        return np.tensordot(functions(model.basis, x)[: len(model.mass)], model.mass, 1)

    def height(x: np.ndarray) -> complex:
        return functions(model.basis, x)[: len(model.potential)] @ model.potential

    steps = np.eye(d) * h * 1j
    uphill = np.array([height(q + e).imag / h for e in steps])
    lively = np.array([(0.5 * v @ inertia(q + e) @ v).imag / h for e in steps])
    turning = inertia(q + 1j * h * v).imag / h @ v
    phi = functions(model.basis, q)
    drive = np.einsum("k,kci,c->i", phi[: len(model.input_map)], model.input_map, u)
    losses = np.tensordot(phi[: len(model.damping)], model.damping, 1) @ v
    losses = losses + model.dry * np.tanh(v / model.width) + model.drag * np.abs(v) * v
    force = lively - turning - uphill - losses + drive + further(-uphill, drive)
    return np.linalg.solve(inertia(q).real, force)


def uneven(n: int, n_u: int, seed: int = 1) -> tuple[np.ndarray, np.ndarray]:
    rng = np.random.default_rng(seed)
    time = np.cumsum(rng.uniform(0.01, 0.04, n))
    return time - time[0], rng.normal(size=(n, n_u))


def followed(
    time: np.ndarray,
    u: np.ndarray,
    held: bool,
    start: np.ndarray,
    rate: Callable[[float, np.ndarray, np.ndarray], np.ndarray],
) -> np.ndarray:
    """States at ``time``, frame by frame, so that no step of the solver straddles a kink of the input."""
    states = [start]
    for n, (a, b) in enumerate(pairwise(time)):

        def slope(t: float, x: np.ndarray, n: int = n, a: float = a, b: float = b) -> np.ndarray:
            now = u[n] if held else u[n] + (u[n + 1] - u[n]) * (t - a) / (b - a)
            return rate(t, x, now)

        states.append(solve_ivp(slope, (a, b), states[-1], method="DOP853", rtol=1e-9, atol=1e-10).y[:, -1])
    return np.array(states)


def rolled(
    model: MechanicalModel,
    time: np.ndarray,
    u: np.ndarray,
    states: np.ndarray,
    windows: WindowSet,
    effects: list[PlacedEffect],
    x: list[float],
    *,
    held: bool,
    steps: int,
) -> tuple[np.ndarray, np.ndarray]:
    """What the kernel says, beginning at the recorded states."""
    d = model.d
    record = Dataset(
        time,
        states[:, :d],
        states[:, d:],
        u,
        np.array([[0, len(time)]]),
        ("made",),
        np.zeros(1, np.int64),
        (0.0,),
        states[:, :d],
    )
    known = NuisanceParameters(*[1.0] * 4, np.ones(d), 1.0, u.shape[1], np.zeros((0, 0)))
    bench = RolloutModel(model, record, known, steps, held)
    whole = np.concatenate([x, np.zeros(known.size)])[None]
    y, v = bench.roll_out(effects, whole, states[windows.first][None], windows)
    return y[0], v[0]


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("d", [1, 2, 4])
def test_a_bare_rollout_is_the_solution_of_lagranges_equations(d: int, held: bool) -> None:
    model, n_u = wild(d, 2), 2
    time, u = uneven(24 if d < 4 else 12, n_u)
    start = np.random.default_rng(3).normal(0.0, 0.6, 2 * d)

    def nothing(spring: np.ndarray, drive: np.ndarray) -> np.ndarray:
        return np.zeros(d)

    def rate(t: float, x: np.ndarray, now: np.ndarray) -> np.ndarray:
        return np.concatenate([x[d:], accelerate(model, x[:d], x[d:], now, nothing)])

    truth = followed(time, u, held, start, rate)
    windows = WindowSet(np.array([0]), np.array([len(time)]))
    y, v = rolled(model, time, u, truth, windows, [], [], held=held, steps=8)
    assert np.abs(y[0] - truth[:, :d]).max() < 2e-6
    assert np.abs(v[0] - truth[:, d:]).max() < 2e-5


def test_model_and_kernel_and_energies_agree_on_the_acceleration() -> None:
    for d in (1, 2, 4):
        model = replace(wild(d, 1), dry=np.linspace(0.05, 0.2, d))
        rng = np.random.default_rng(4)
        q, v, u = rng.normal(0.0, 0.5, (5, d)), rng.normal(0.0, 1.0, (5, d)), rng.normal(size=(5, 1))
        told = model.acceleration(q, v, u)
        for n in range(5):
            right = accelerate(model, q[n], v[n], u[n], lambda spring, drive, d=d: np.zeros(d))
            assert told[n] == pytest.approx(right, rel=1e-9, abs=1e-9)
        assert np.abs(np.einsum("nij,nj->ni", model.mass_at(q), told) - model.force(q, v, u)).max() < 1e-9


@pytest.mark.parametrize("held", [False, True])
@pytest.mark.parametrize("d", [1, 2, 4])
def test_three_forces_with_memories_act_at_once(d: int, held: bool) -> None:
    """Hysteresis, creep and a hidden mode, each along a direction of its own."""
    model, known = wild(d, 1, seed=7), catalogue()
    time, u = uneven(24 if d < 4 else 12, 1, seed=8)
    rng = np.random.default_rng(9)
    along = [rng.normal(size=d) for _ in range(3)]
    heavy = [1.3, 0.8, 2.1]
    places = [
        Direction(f"p{i}", p, m, float(p @ model.rest))
        for i, (p, m) in enumerate(zip(along, heavy, strict=True))
    ]
    names = ("hysteresis", "creep", "hidden_mode")
    effects = [
        PlacedEffect(known[name], UNIT, direction=place) for name, place in zip(names, places, strict=True)
    ]
    level, far, power, ratio, constant, mass, omega, zeta = 0.4, 0.6, 1.5, 0.3, 0.25, 0.2, 9.0, 0.05
    unknown_level = level / UNIT.of("acceleration")
    x = [unknown_level, math.log(far), math.log(power), ratio, math.log(constant)]
    x += [mass, math.log(omega), math.log(zeta)]

    def rate(t: float, state: np.ndarray, now: np.ndarray) -> np.ndarray:
        q, v, (bent, late, s2, v2) = state[:d], state[d : 2 * d], state[2 * d :]
        s = [float(p @ (q - model.rest)) for p in along]
        w = [float(p @ v) for p in along]
        pull = omega**2 * (s2 - s[2]) + 2.0 * zeta * omega * (v2 - w[2])

        def further(spring: np.ndarray, drive: np.ndarray) -> np.ndarray:
            rub = -level * bent
            back = -ratio * UNIT.stiffness * (s[1] - late)
            return sum(p * m * f for p, m, f in zip(along, heavy, (rub, back, mass * pull), strict=True))

        bending = w[0] * (1.0 - 0.5 * abs(bent) ** power * (1.0 + np.sign(w[0] * bent))) / far
        return np.concatenate(
            [v, accelerate(model, q, v, now, further), [bending, (s[1] - late) / constant, v2, -pull]]
        )

    q0, v0 = rng.normal(0.0, 0.5, d), rng.normal(0.0, 0.6, d)
    memory = [0.0, along[1] @ (q0 - model.rest), along[2] @ (q0 - model.rest), along[2] @ v0]
    truth = followed(time, u, held, np.concatenate([q0, v0, memory]), rate)
    windows = WindowSet(np.array([0]), np.array([len(time)]))
    y, _ = rolled(model, time, u, truth[:, : 2 * d], windows, effects, x, held=held, steps=32)
    assert np.abs(y[0] - truth[:, :d]).max() < 2e-5


@pytest.mark.parametrize("d", [1, 2])
def test_dry_friction_is_lugres_ever_closer_with_shorter_steps(d: int) -> None:
    """Load-dependent friction along a controlled direction, whose bristles the steps resolve."""
    model, known = wild(d, 1, seed=7), catalogue()
    time, u = uneven(60, 1, seed=8)
    rng = np.random.default_rng(9)
    along, heavy, factor, level, presliding, damping = rng.normal(size=d), 1.3, 0.2, 6.0, 0.03, 0.8
    place, gain = Direction("p", along, heavy, float(along @ model.rest)), 1.5
    x = [factor, level / UNIT.of("acceleration"), math.log(presliding), math.log(damping)]

    def rate(t: float, state: np.ndarray, now: np.ndarray) -> np.ndarray:
        q, v, share = state[:d], state[d : 2 * d], state[2 * d]
        w = float(along @ v)
        bending = (w - abs(w) * share) / presliding
        mobility = heavy * float(along @ np.linalg.solve(model.mass_at(q[None])[0], along))

        def further(spring: np.ndarray, drive: np.ndarray) -> np.ndarray:
            most = level + factor * abs(
                float(along @ (spring - drive)) / heavy + 2.0 * gain * float(along @ q)
            )
            grip = most * share + damping * math.sqrt(most * presliding / mobility) * bending
            return -along * heavy * grip

        return np.concatenate([v, accelerate(model, q, v, now, further), [bending]])

    start = np.concatenate([rng.normal(0.0, 0.5, d), along / (along @ along)])
    truth = followed(time, u, False, np.concatenate([start, [1.0]]), rate)
    turns = np.sum(np.diff(np.sign(truth[:, d : 2 * d] @ along)) != 0.0)
    assert turns >= 2
    windows, constants = WindowSet(np.array([0]), np.array([60])), (gain, place.rest)
    effects = [PlacedEffect(known["load_dependent_friction"], UNIT, direction=place, constants=constants)]
    off = []
    for steps in (4, 16, 64):
        y, _ = rolled(model, time, u, truth[:, : 2 * d], windows, effects, x, held=False, steps=steps)
        off.append(float(np.abs(y[0] - truth[:, :d]).max() / np.ptp(truth[:, :d])))
    assert off[0] < 3e-3
    assert off[2] < 0.3 * off[1] < 0.09 * off[0]


def spring(omega: float) -> MechanicalModel:
    """An oscillator without losses."""
    basis = make_polynomial_basis(2, centre=np.zeros(1), scale=np.ones(1))
    return MechanicalModel(
        *(basis, np.ones((1, 1, 1)), np.zeros((1, 1, 1)), np.array([0.0, 0.0, 0.5 * omega**2])),
        *(np.zeros((1, 0, 1)), np.zeros(1), np.zeros(1), np.ones(1), np.zeros(1)),
    )


def test_what_rests_where_a_window_begins_is_held() -> None:
    """However it came to rest, within the band that friction can hold; beyond it, it moves."""
    omega, level = 2.0 * math.pi, 2.0
    effect = PlacedEffect(catalogue()["coulomb_friction"], UNIT, direction=Direction("q", np.ones(1), 1.0))
    x = [level / UNIT.of("acceleration"), math.log(0.02), 0.0]
    time = np.arange(80) / 40.0
    for share, moves in ((0.95, False), (-0.5, False), (1.3, True)):
        states = np.tile([share * level / omega**2, 0.0], (80, 1))
        windows = WindowSet(np.array([0]), np.array([80]))
        no_inputs = np.zeros((80, 0))
        y, _ = rolled(spring(omega), time, no_inputs, states, windows, [effect], x, held=False, steps=1)
        assert (np.abs(y[0, :, 0] - states[:, 0]).max() > 1e-3) == moves
        assert moves or np.abs(y[0, :, 0] - states[:, 0]).max() < 1e-12


def test_the_models_own_dry_friction_holds_as_an_effect_of_it_does() -> None:
    """And both together as one of their sum, in motion and at rest."""
    own, level, steps = 0.8, 2.0, 2
    effect = PlacedEffect(catalogue()["coulomb_friction"], UNIT, direction=Direction("q", np.ones(1), 1.0))
    time, u = np.arange(281) / 40.0, np.zeros((281, 0))
    states = np.stack([np.cos(2.0 * math.pi * time) * np.exp(-0.4 * time), np.zeros(281)], axis=1)
    windows = WindowSet(np.array([0]), np.array([281]))
    paths = []
    for dry, more in ((level, 0.0), (0.0, level), (own, level - own)):
        model = replace(spring(2.0 * math.pi), dry=np.array([dry]))
        x = [more / UNIT.of("acceleration"), math.log(PRESLIDING_SHARE), 0.0]
        effects, x = ([effect], x) if more else ([], [])
        run = rolled(model, time, u, states, windows, effects, x, held=False, steps=steps)
        paths.append(run[0][0, :, 0])
    assert np.abs(paths[1] - paths[0]).max() < 1e-9
    assert np.ptp(paths[0][:60]) > 1.0
    assert np.ptp(paths[0][-20:]) < 1e-4
    assert np.abs(paths[2] - paths[0]).max() < 1e-3


@pytest.mark.parametrize("steps", [1, 4])
def test_friction_of_stiff_bristles_is_set_valued(steps: int) -> None:
    """An oscillator loses the same at each turn and rests off its equilibrium, for good."""
    omega, level = 2.0 * math.pi, 2.0
    model = spring(omega)
    time = np.arange(401) / 40.0
    band = level / omega**2
    turn = np.minimum(np.floor(2.0 * time), 9.0)
    side = (-1.0) ** turn
    truth = side * band + (1.0 - (2.0 * turn + 1.0) * band) * np.cos(omega * time)
    truth[time > 5.0] = truth[200]
    effect = PlacedEffect(catalogue()["coulomb_friction"], UNIT, direction=Direction("q", np.ones(1), 1.0))
    states = np.stack([truth, np.gradient(truth, time)], axis=1)
    states[0] = 1.0, 0.0
    x = [level / UNIT.of("acceleration"), math.log(1e-12), 0.0]
    windows = WindowSet(np.array([0]), np.array([len(time)]))
    y, v = rolled(model, time, np.zeros((401, 0)), states, windows, [effect], x, held=False, steps=steps)
    assert np.abs(y[0, :, 0] - truth).max() < 4e-4 / steps**1.5
    assert np.ptp(y[0, 210:, 0]) == 0.0
    assert np.abs(v[0, 210:]).max() < 1e-15


def test_memories_are_carried_along_the_record_to_where_a_window_begins() -> None:
    model, known = wild(1, 0, seed=7), catalogue()
    time = np.arange(60) * 0.01
    constant = 0.2

    def rate(t: float, x: np.ndarray, now: np.ndarray) -> np.ndarray:
        s = x[0] - model.rest[0]
        push = np.array([-0.5 * UNIT.stiffness * (s - x[2])])
        return np.concatenate(
            [
                x[1:2],
                accelerate(model, x[:1], x[1:2], now, lambda spring, drive: push),
                [(s - x[2]) / constant],
            ]
        )

    start = np.array([0.6, 0.0, 0.6 - model.rest[0]])
    truth = followed(time, np.zeros((60, 0)), False, start, rate)
    place = Direction("q", np.ones(1), 1.0, float(model.rest[0]))
    creep = PlacedEffect(known["creep"], UNIT, direction=place)
    windows = WindowSet(np.array([0, 30]), np.array([60, 30]))
    y, _ = rolled(
        model,
        time,
        np.zeros((60, 0)),
        truth[:, :2],
        windows,
        [creep],
        [0.5, math.log(constant)],
        held=False,
        steps=4,
    )
    assert np.abs(y[1, :30, 0] - truth[30:, 0]).max() < 2e-5
    forgotten = truth[30:, 0] - y[0, :30, 0]
    assert np.abs(forgotten).max() > 1e-2  # else the memory would not matter


def test_changes_of_input_model_and_camera_act_together() -> None:
    """A saturated input, a heavier mechanism, drag on the whole, and a zoomed picture."""
    model, known = wild(2, 1, seed=3), catalogue()
    time, u = uneven(24, 1)
    limit, sharpness, ratio, gain, zoom, shift = 0.6, 5.0, 1.4, 0.35, 0.1, -0.2
    place = Direction("q1", np.array([0.0, 1.0]), 1.0, float(model.rest[1]))
    effects = [
        PlacedEffect(known["input_saturation"], UNIT, channel=0),
        PlacedEffect(known["mass_change"], UNIT),
        PlacedEffect(known["viscous_damping"], UNIT),
        PlacedEffect(known["camera_change"], UNIT, direction=place),
    ]
    inside = u / (1.0 + np.abs(u / limit) ** sharpness) ** (1.0 / sharpness)
    heavy = replace(model, mass=ratio * model.mass)

    def rate(t: float, x: np.ndarray, now: np.ndarray) -> np.ndarray:
        def further(spring: np.ndarray, drive: np.ndarray) -> np.ndarray:
            return -gain * model.inertia @ x[2:]

        return np.concatenate([x[2:], accelerate(heavy, x[:2], x[2:], now, further)])

    start = np.array([0.4, -0.3, 0.5, 0.2])
    truth = followed(time, inside, True, start, rate)
    windows = WindowSet(np.array([0]), np.array([len(time)]))
    y, _ = rolled(
        model,
        time,
        u,
        truth,
        windows,
        effects,
        [math.log(limit), math.log(sharpness), math.log(ratio), gain, zoom, shift],
        held=True,
        steps=8,
    )
    seen = truth[:, :2].copy()
    seen[:, 1] += zoom * (truth[:, 1] - model.rest[1]) + shift
    assert np.abs(y[0] - seen).max() < 5e-6


def test_a_rollout_that_leaves_for_good_stays_where_it_is_lost() -> None:
    """Anti-damping so strong that it overflows: no number that is not finite comes back."""
    model, known = wild(1, 0), catalogue()
    time = np.arange(200) * 0.02
    states = np.tile([0.5, 0.0], (200, 1))
    effect = PlacedEffect(known["viscous_damping"], UNIT, direction=Direction("q", np.ones(1), 1.0))
    y, v = rolled(
        model,
        time,
        np.zeros((200, 0)),
        states,
        WindowSet(np.array([0]), np.array([200])),
        [effect],
        [-80.0],
        held=False,
        steps=1,
    )
    assert np.isfinite(y).all()
    assert np.isfinite(v).all()
    assert y[0, -1, 0] == model.rest[0] + DIVERGED_SCALES * model.basis.scale[0]


def test_every_set_of_a_batch_is_what_it_is_alone() -> None:
    model, known = wild(2, 1), catalogue()
    time, u = uneven(20, 1)
    states = np.random.default_rng(0).normal(0.0, 0.4, (20, 4))
    record = Dataset(
        time,
        states[:, :2],
        states[:, 2:],
        u,
        np.array([[0, 20]]),
        ("made",),
        np.zeros(1, np.int64),
        (0.0,),
        states[:, :2],
    )
    spare = NuisanceParameters(*[1.0] * 4, np.ones(2), 1.0, 1, np.zeros((0, 0)))
    bench = RolloutModel(model, record, spare, 2, False)
    effects = [
        PlacedEffect(known["input_lag"], UNIT, channel=0),
        PlacedEffect(known["creep"], UNIT, direction=Direction("q0", np.array([1.0, 0.0]), 2.0)),
    ]
    windows = WindowSet(np.array([0, 5, 12]), np.array([6, 8, 5]))
    x = 0.1 * np.random.default_rng(1).normal(size=(4, 3 + spare.size)) + np.array(
        [-2.0, 0.3, -1.0] + [0.0] * spare.size
    )
    starts = np.random.default_rng(2).normal(0.0, 0.4, (4, 3, 4))
    together = bench.roll_out(effects, x, starts, windows)[0]
    for n in range(4):
        alone = bench.roll_out(effects, x[n : n + 1], starts[n : n + 1], windows)[0]
        for w, length in enumerate(windows.length):
            assert np.array_equal(together[n, w, :length], alone[0, w, :length])
