"""What holds for every effect: absent it does nothing, priors are densities, passive ones feed no energy."""

import math
from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest
from scipy.integrate import quad, solve_ivp

from lagsplat.diagnose.effects.actuation import (
    cogging,
    controller_gain,
    input_backlash,
    input_dead_zone,
    input_delay,
    input_gain,
    input_lag,
    input_saturation,
    torque_speed_limit,
)
from lagsplat.diagnose.effects.base import (
    DisturbanceHints,
    ForceEffect,
    ObservationEffect,
    PlacedEffect,
    SampleEffect,
)
from lagsplat.diagnose.effects.elasticity import (
    circulatory_force,
    creep,
    cubic_stiffness,
    end_stop,
    hysteresis,
    joint_backlash,
    linear_stiffness,
    parametric_stiffness,
)
from lagsplat.diagnose.effects.external import (
    base_motion,
    constant_force,
    external_periodic_force,
    external_push,
    parameter_drift,
)
from lagsplat.diagnose.effects.friction import (
    asymmetric_friction,
    coulomb_friction,
    load_dependent_friction,
    position_dependent_damping,
    quadratic_drag,
    stribeck_friction,
    viscous_damping,
)
from lagsplat.diagnose.effects.inertia import armature, hidden_mode, mass_change, payload
from lagsplat.diagnose.effects.measurement import (
    camera_change,
    camera_drift,
    encoder_scale,
    exposure_blur,
    frame_drops,
    time_jitter,
    time_offset,
)
from lagsplat.diagnose.effects.parameters import UNITS, LogNormal, Normal, Scales
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.estimation.dataset import Dataset, WindowSet
from lagsplat.diagnose.estimation.nuisance import NuisanceParameters
from lagsplat.diagnose.estimation.rollout import RolloutModel
from lagsplat.diagnose.inference.placement import place_effects
from tests.unit.diagnose.toys import coupled, name_place

EFFECTS = {
    module.EFFECT.name: module.EFFECT
    for module in (
        armature,
        asymmetric_friction,
        base_motion,
        camera_change,
        camera_drift,
        circulatory_force,
        cogging,
        constant_force,
        controller_gain,
        coulomb_friction,
        creep,
        cubic_stiffness,
        encoder_scale,
        end_stop,
        exposure_blur,
        external_periodic_force,
        external_push,
        frame_drops,
        hidden_mode,
        hysteresis,
        input_backlash,
        input_dead_zone,
        input_delay,
        input_gain,
        input_lag,
        input_saturation,
        joint_backlash,
        linear_stiffness,
        load_dependent_friction,
        mass_change,
        parameter_drift,
        parametric_stiffness,
        payload,
        position_dependent_damping,
        quadratic_drag,
        stribeck_friction,
        time_jitter,
        time_offset,
        torque_speed_limit,
        viscous_damping,
    )
}
UNIT = Scales(coordinate=0.5, velocity=3.0, reach=1.0, frame_s=0.02, duration_s=8.0, stiffness=36.0)
PASSIVE = (
    *("coulomb_friction", "stribeck_friction", "load_dependent_friction", "asymmetric_friction"),
    *("quadratic_drag", "position_dependent_damping", "end_stop", "creep", "hidden_mode"),
)
NOTHING = 690.0
"""As a logarithm, nothing at all: exp(-690) is next to the smallest number."""


@pytest.fixture(scope="module")
def bench() -> RolloutModel:
    """Two coupled coordinates and two inputs, at rest and in motion."""
    model = coupled()
    rng = np.random.default_rng(2)
    time = np.cumsum(rng.uniform(0.02, 0.04, 80))
    phase = rng.uniform(0.0, 6.0, (4, 1))
    waves = np.sin(np.array([[2.1], [3.3], [1.7], [4.1]]) * time + phase)
    q, u = 0.6 * waves[:2].T, waves[2:].T
    v = np.gradient(q, time, axis=0)
    record = Dataset(
        time, q, v, u, np.array([[0, 50], [50, 80]]), ("a", "b"), np.array([0, 1]), (0.0, 0.0), q
    )
    known = NuisanceParameters(*[0.01] * 4, np.full(2, 0.01), 0.01, 2, np.zeros((0, 0)))
    return RolloutModel(model, record, known, 2, False)


WINDOWS = WindowSet(np.array([0, 30, 50]), np.array([31, 20, 30]))


def offers(bench: RolloutModel) -> list[PlacedEffect]:
    pushes, lines = ((0.4, 0.7), (1.1, 1.3)), (0.7, 1.9)
    hints = [DisturbanceHints(pushes, lines, lines, (0.7, share)) for share in (1.0, -0.6)]
    targets = {"left": "a"}
    return place_effects(
        bench, hints, q_names=("a", "b"), u_names=("left", "right"), without=(), targets=targets
    )


def starts(bench: RolloutModel) -> np.ndarray:
    return np.concatenate([bench.dataset.q, bench.dataset.v], axis=1)[WINDOWS.first]


def usual(one: PlacedEffect) -> np.ndarray:
    """Unknowns of the size that is expected, with the shapes of the first guess."""
    effect = one.effect
    x = np.array([p.prior.mean + p.prior.deviation for p in effect.parameters])
    shapes = [effect.parameters[i] for i in effect.shapes]
    grid = one.grid[0] if one.grid else tuple(p.grid[0] for p in shapes)
    x[effect.shapes] = [p.prior.unknown(g) for p, g in zip(shapes, grid, strict=True)]
    return x


def absent(one: PlacedEffect) -> np.ndarray:
    """Unknowns with which the effect is not there."""
    if one.parts:
        return np.concatenate([absent(part) for part in one.parts])
    x = usual(one)
    if len(one.effect.amplitudes):
        x[one.effect.amplitudes] = 0.0
        return x
    if isinstance(one.effect.parameters[0].prior, LogNormal):
        limits = ("input_saturation", "torque_speed_limit")
        x[0] = NOTHING if one.effect.name in limits else -NOTHING
        if one.effect.name == "torque_speed_limit":
            x[1] = NOTHING
    else:
        x[0] = 0.0
    if one.effect.name == "input_backlash":
        x[1] = 0.0
    return x


def moved(bench: RolloutModel, one: PlacedEffect | None, x: np.ndarray) -> np.ndarray:
    whole = np.concatenate([x, np.zeros(bench.nuisance.size)])[None]
    return bench.roll_out([one] if one else [], whole, starts(bench)[None], WINDOWS)[0][0]


def test_the_catalogue_is_what_is_tested_here() -> None:
    assert catalogue() == EFFECTS
    assert len(EFFECTS) == 40


@pytest.mark.parametrize("held", [False, True])
def test_an_effect_that_is_absent_changes_nothing(bench: RolloutModel, held: bool) -> None:
    bench = replace(bench, held=held)
    reference = moved(bench, None, np.zeros(0))
    seen = set()
    for one in offers(bench):
        if isinstance(one.effect, SampleEffect):
            continue
        seen.add(one.effect.name)
        assert np.abs(moved(bench, one, absent(one)) - reference).max() <= 1e-12, name_place(one)
    assert seen == {name for name, effect in EFFECTS.items() if not isinstance(effect, SampleEffect)}


def test_an_effect_that_is_there_changes_something(bench: RolloutModel) -> None:
    reference = moved(bench, None, np.zeros(0))
    for one in offers(bench):
        if not isinstance(one.effect, SampleEffect):
            assert np.abs(moved(bench, one, usual(one)) - reference).max() > 1e-4, name_place(one)


def test_a_window_is_seen_as_it_is_alone(bench: RolloutModel) -> None:
    """Also to its last frame, beside one that is longer."""
    for one in offers(bench):
        if not isinstance(one.effect, ObservationEffect):
            continue
        x = usual(one)
        together = moved(bench, one, x)
        for w, length in enumerate(WINDOWS.length):
            only = WINDOWS.select(np.array([w]))
            whole = np.concatenate([x, np.zeros(bench.nuisance.size)])[None]
            alone = bench.roll_out([one], whole, starts(bench)[None, [w]], only)[0][0, 0]
            assert np.abs(together[w, :length] - alone).max() < 1e-12, name_place(one)


def test_slopes_by_forward_steps_are_central_differences_to_a_part_in_a_hundred(bench: RolloutModel) -> None:
    """The step is the one that shooting takes."""
    for one in offers(bench):
        if isinstance(one.effect, SampleEffect) or one.effect.name == "external_push":
            continue  # the prior of the time of a push is as wide as the day; its step is a matter of its own
        x = 0.7 * usual(one) if len(one.effect.amplitudes) else usual(one)
        for i, parameter in enumerate(one.effect.parameters):
            step = np.zeros(len(x))
            step[i] = 1e-3 * min(parameter.prior.deviation, 1.0)
            middle, ahead, behind = (moved(bench, one, x + sign * step) for sign in (0, 1, -1))
            forward, central = (ahead - middle) / step[i], (ahead - behind) / (2.0 * step[i])
            off = np.linalg.norm(forward - central)
            assert off <= 0.02 * np.linalg.norm(central) + 1e-9, (name_place(one), parameter.name)


@pytest.mark.parametrize("name", PASSIVE)
def test_a_passive_effect_never_feeds_energy_over_a_closed_cycle(name: str) -> None:
    """From rest around and back to rest, with nothing stored at first."""
    effect = EFFECTS[name]
    assert isinstance(effect, ForceEffect)
    rng = np.random.default_rng(5)
    for variant in effect.variants:
        for _ in range(4):
            x = [max(rng.normal(p.prior.mean, p.prior.deviation), p.prior.lowest) for p in effect.parameters]
            physical = PlacedEffect(effect, UNIT).to_physical(np.array([x]))[0]
            theta = np.concatenate([physical, effect.constants(UNIT, variant), np.zeros(2)])
            assert work(effect, theta, rng.normal(0.0, 0.4, 3), rng.uniform(1.0, 3.0)) <= 1e-5, (name, theta)


def work(effect: ForceEffect, theta: np.ndarray, size: np.ndarray, drive: float) -> float:
    """Of the effect on a motion of three harmonics, with a spring and a drive for load."""
    turns = np.array([1.0, 2.0, 3.0])

    def rate(t: float, x: np.ndarray) -> list[float]:
        s = float(size @ (np.cos(turns * t) - 1.0))
        v = float(-(size * turns) @ np.sin(turns * t))
        store = np.zeros(effect.n_memory)
        a = effect.law.__wrapped__(t, s, v, -36.0 * s, 5.0 * math.sin(drive * t), x[:-1].copy(), theta, store)
        return [*store, a * v]

    blank = np.zeros(effect.n_memory + 1)
    done = solve_ivp(rate, (0.0, 2.0 * np.pi), blank, rtol=1e-6, atol=1e-8, max_step=0.05)
    assert done.success
    return float(done.y[-1, -1])


def test_dissipative_effects_are_marked_so() -> None:
    assert {
        "coulomb_friction",
        "stribeck_friction",
        "load_dependent_friction",
        "quadratic_drag",
        "creep",
        "hidden_mode",
        "end_stop",
    } <= set(PASSIVE)
    assert not {"external_push", "external_periodic_force", "constant_force", "viscous_damping"} & set(
        PASSIVE
    )


def mass(prior: Normal) -> float:
    """Of the density of the unknown, where it may be."""
    low = max(prior.mean - 12.0 * prior.deviation, prior.lowest)
    high = prior.mean + 12.0 * prior.deviation
    return quad(lambda x: math.exp(prior.log_density(x)), low, high, points=[prior.mean], epsabs=1e-12)[0]


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_priors_are_densities_and_parameters_come_back(name: str) -> None:
    for parameter in EFFECTS[name].parameters:
        prior = parameter.prior
        assert mass(prior) == pytest.approx(1.0, abs=1e-9)
        for value in (*parameter.grid, 0.037, 1.0, 4.2):
            assert prior.value(prior.unknown(value)) == pytest.approx(value, rel=1e-14)
        size = UNIT.of(parameter.kind)
        assert size > 0.0
        assert math.isfinite(size)
        assert parameter.kind in UNITS


@pytest.mark.parametrize("name", sorted(EFFECTS))
def test_what_cannot_be_zero_has_guesses(name: str) -> None:
    effect = EFFECTS[name]
    if not isinstance(effect, SampleEffect):
        assert all(p.grid for p in effect.parameters if isinstance(p.prior, LogNormal))
    assert effect.equation
    assert effect.needs
    assert effect.group in "ABCDEFG"


def test_a_limit_is_approached_gently_or_cut_sharply() -> None:
    u = np.linspace(-3.0, 3.0, 61)
    change = input_saturation.change
    signal = SimpleNamespace(values=u)
    sharp, gentle, straightest = change(signal, np.array([[1.0, 300.0], [1.0, 2.0], [1.0, 1.0]]))
    assert sharp == pytest.approx(np.clip(u, -1.0, 1.0), abs=3e-3)
    assert gentle == pytest.approx(u / np.sqrt(1.0 + u**2))
    assert straightest == pytest.approx(u / (1.0 + np.abs(u)))
    assert np.isfinite(change(signal, np.array([[1e-12, 1e3], [1e12, 1e3]]))).all()


def test_sizes_scale_with_the_unit_of_the_coordinate() -> None:
    """In a unit a thousand times as small every parameter is the same number of its own units."""
    fine = replace(
        UNIT, coordinate=1e3 * UNIT.coordinate, velocity=1e3 * UNIT.velocity, reach=1e3 * UNIT.reach
    )
    powers = {
        "acceleration": 1,
        "coordinate": 1,
        "velocity": 1,
        "reach": 1,
        "drift": 1,
        "per_coordinate": -1,
        "slowness": -1,
        "cubic": -2,
    }
    for kind in UNITS:
        assert fine.of(kind) == pytest.approx(UNIT.of(kind) * 1e3 ** powers.get(kind, 0), rel=1e-12), kind


def test_jitter_and_late_frames_are_told_from_even_noise() -> None:
    rng = np.random.default_rng(0)
    speed = 40.0 * np.sin(np.linspace(0.0, 30.0, 800))[:, None]
    even = rng.standard_normal((800, 1))
    jitter, drops = (EFFECTS[name].explain for name in ("time_jitter", "frame_drops"))  # type: ignore[attr-defined]
    assert jitter(even, speed)[0] < 6.0
    assert drops(even, speed)[0] < 6.0
    shaken = even + 0.1 * speed * rng.standard_normal((800, 1))
    gain, found, misfit = jitter(shaken, speed)
    assert gain > 100.0
    assert np.ravel(found["std"])[0] == pytest.approx(0.1, rel=0.1)
    assert misfit < 2.0 * 800
    late = np.isin(np.arange(800), rng.choice(800, 24, replace=False))[:, None]
    gain, found, misfit = drops(even - np.where(late, speed, 0.0), speed)
    assert gain > 100.0
    assert np.ravel(found["count"])[0] == pytest.approx(24, abs=6)
    assert misfit < 1.1 * 800


def test_effects_on_one_input_act_one_after_another(bench: RolloutModel) -> None:
    found = offers(bench)
    gain, lag, limit = (
        next(each for each in found if each.effect.name == name and each.location == "left")
        for name in ("input_gain", "input_lag", "input_saturation")
    )
    x = [np.full(gain.size, 0.3), np.append(usual(lag)[:1], np.zeros(lag.size - 1)), usual(limit)]
    spare = np.zeros(bench.nuisance.size)
    together = bench.roll_out(
        [gain, lag, limit], np.concatenate([*x, spare])[None], starts(bench)[None], WINDOWS
    )[0]
    left = np.array([np.exp(gain.to_physical(x[0][None])[0, 0]), 1.0])
    louder = replace(bench, dataset=replace(bench.dataset, u=bench.dataset.u * left))
    others = louder.roll_out(
        [lag, limit], np.concatenate([*x[1:], spare])[None], starts(bench)[None], WINDOWS
    )[0]
    np.testing.assert_allclose(together, others, rtol=1e-9, atol=1e-12)
    for alone in ([gain], [lag], [limit], [gain, limit]):
        part = np.concatenate([x[[gain, lag, limit].index(each)] for each in alone])
        apart = bench.roll_out(alone, np.concatenate([part, spare])[None], starts(bench)[None], WINDOWS)[0]
        assert np.abs(apart - together).max() > 1e-3
