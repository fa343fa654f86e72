"""Effects put in by laws written here come out under their own names, from short films."""

import math
from dataclasses import replace

import numpy as np
import pytest

from lagsplat.diagnose.augmented.model import build_augmented
from lagsplat.diagnose.core.result import Diagnosis
from lagsplat.diagnose.diagnosis import diagnose
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.estimation.dataset import sample_operating_region
from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator
from lagsplat.io.trajectory.trajectory import Trajectory
from tests.unit.diagnose.toys import GAIN, HARD, OMEGA, film, oscillator, own, settings, wave

RIVALS = (
    "coulomb_friction",
    "quadratic_drag",
    "viscous_damping",
    "linear_stiffness",
    "cubic_stiffness",
    "constant_force",
    "mass_change",
    "input_gain",
    "input_lag",
    "input_delay",
    "input_saturation",
    "input_dead_zone",
    "creep",
    "hidden_mode",
    "external_periodic_force",
)
U = wave(4)


def acting(extra, *, u=U, command=None, start=(0.8, 0.0), seconds=12.0) -> Trajectory:
    """The oscillator, driven, with a further acceleration of (t, q, v, u)."""
    return film(
        lambda t, q, v, now, z: (own(q, v, now) + extra(t, q, v, now), []),
        u=u,
        command=command or u,
        start=start,
        seconds=seconds,
    )


def nothing(t: float, q: float, v: float, u: float) -> float:
    return 0.0


def creeping() -> Trajectory:
    """A Maxwell branch of a fifth of the stiffness and 0.3 s."""
    return film(
        lambda t, q, v, u, z: (own(q, v, u) - 0.2 * OMEGA**2 * (q - z[0]), [(q - z[0]) / 0.3]),
        u=U,
        start=(0.8, 0.0, 0.8),
    )


def lagging() -> Trajectory:
    """The command reaches the mechanism through 0.1 s, from where it begins."""
    return film(
        lambda t, q, v, u, z: (own(q, v, 0.0) + GAIN * z[0], [(u - z[0]) / 0.1]),
        u=U,
        start=(0.8, 0.0, U(0.0)),
    )


def carrying(away: float = 0.0) -> Trajectory:
    """A second mass, an eighth of the first, on a spring that swings at 2.2 Hz, from ``away`` of its rest."""
    w = 2.0 * np.pi * 2.2

    def law(t, q, v, u, z):
        pull = w * w * (z[0] - q) + 2.0 * 0.03 * w * (z[1] - v)
        return own(q, v, u) + 0.125 * pull, [z[1], -pull]

    return film(law, u=U, start=(0.8, 0.0, 0.8 + away, 0.0))


CASES = {
    "coulomb_friction": (
        lambda: acting(lambda t, q, v, u: -2.5 * math.tanh(v / 0.02)),
        {"acceleration": 2.5},
    ),
    "quadratic_drag": (lambda: acting(lambda t, q, v, u: -0.4 * abs(v) * v), {"coefficient": 0.4}),
    "viscous_damping": (lambda: acting(lambda t, q, v, u: -1.0 * v), {"rate": 1.0}),
    "linear_stiffness": (
        lambda: acting(lambda t, q, v, u: -0.2 * (OMEGA**2 * q + HARD * q**3)),
        {"ratio": 1.2},
    ),
    "cubic_stiffness": (lambda: acting(lambda t, q, v, u: -9.0 * q**3), {"coefficient": 9.0}),
    "constant_force": (lambda: acting(lambda t, q, v, u: 6.0), {"acceleration": 6.0}),
    "mass_change": (
        lambda: film(lambda t, q, v, u, z: (own(q, v, u) / 1.3, []), u=U, start=(0.8, 0.0)),
        {"ratio": 1.3},
    ),
    "input_gain": (lambda: acting(nothing, u=lambda t: 0.7 * U(t), command=U), {"ratio": 0.7}),
    "input_lag": (lagging, {"time_constant": 0.1}),
    "input_saturation": (
        lambda: acting(nothing, u=lambda t: min(max(U(t), -0.9), 0.9), command=U),
        {"limit": 0.9},
    ),
    "input_dead_zone": (
        lambda: acting(nothing, u=lambda t: math.copysign(max(abs(U(t)) - 0.3, 0.0), U(t)), command=U),
        {"half_width": 0.3},
    ),
    "creep": (creeping, {"stiffness_ratio": 0.2, "time_constant": 0.3}),
    "hidden_mode": (carrying, {"mass_ratio": 0.125, "frequency_hz": 2.2}),
    "external_periodic_force": (
        lambda: acting(lambda t, q, v, u: 8.0 * math.sin(2.0 * math.pi * 1.6 * t + 0.4)),
        {"frequency_hz": 1.6, "acceleration": 8.0},
    ),
}


def diagnosed(clean: Trajectory) -> Diagnosis:
    noise = 0.005 * clean.q.std() * np.random.default_rng(0).standard_normal(clean.q.shape)
    left_out = sorted(set(catalogue()) - set(RIVALS))
    config = replace(settings(), without=left_out, always_fitted=[], families=4, starts=2, places=1)
    return diagnose(
        EstimatedSimulator.exact(oscillator()), [replace(clean, q=clean.q + noise)], config
    ).diagnosis


def test_a_spring_beside_a_potential_of_another_shape_is_a_stiffness() -> None:
    """No share of the hardening potential, which at these swings is no spring's."""
    found = diagnosed(acting(lambda t, q, v, u: -0.2 * OMEGA**2 * q, start=(1.2, 0.0)))
    assert found.candidates[0].name == "linear_stiffness"
    assert found.combination == ("linear_stiffness",)
    assert found.candidates[0].parameters["ratio"].value == pytest.approx(1.2, rel=0.02)
    creep = next(one for one in found.candidates if one.name == "creep")
    assert creep.parameters["time_constant"].value > 6.0  # half of the film: it never relaxes
    assert creep.probability < 0.5 * found.candidates[0].probability


@pytest.mark.parametrize("name", CASES)
def test_an_effect_recovers_itself_with_its_parameters(name: str) -> None:
    make, parameters = CASES[name]
    found = diagnosed(make())
    assert found.verdict == "effect"
    assert found.candidates[0].name == name
    assert name in found.combination
    assert found.candidates[0].probability > 0.5
    for key, value in parameters.items():
        assert found.candidates[0].parameters[key].value == pytest.approx(value, rel=0.05), key
    assert found.gap is not None
    assert found.gap.closure.value > 0.95


def test_a_second_mass_may_swing_already_where_the_recording_begins() -> None:
    clean = carrying(away=2.0)
    noise = 0.005 * clean.q.std() * np.random.default_rng(0).standard_normal(clean.q.shape)
    config = replace(
        settings(), without=sorted(set(catalogue()) - {"hidden_mode"}), always_fitted=[], starts=2
    )
    whole = diagnose(EstimatedSimulator.exact(oscillator()), [replace(clean, q=clean.q + noise)], config)
    found, bench = whole.diagnosis, whole.problem.rollout_model
    assert found.candidates[0].parameters["mass_ratio"].value == pytest.approx(0.125, rel=0.05)
    assert found.candidates[0].misfit == pytest.approx(1.0, abs=0.15)
    assert set(found.candidates[0].parameters) == {"mass_ratio", "frequency_hz", "damping_ratio"}
    kept = build_augmented(
        bench,
        whole.chosen.effects,
        whole.chosen.fit.x,
        q_names=["q0"],
        u_names=["u0"],
        region=sample_operating_region(bench.dataset),
    )
    assert set(kept.parameters(0)) == {"mass_ratio", "angular_frequency", "damping_ratio"}
    assert len(kept.x) == 3 + bench.nuisance.size


def test_without_any_noise_the_parameter_is_found_as_well() -> None:
    """The best fit, which fifty steps reach: a ratio of 1.2 and no uncertainty moved."""
    config = replace(
        settings(), without=sorted(set(catalogue()) - {"linear_stiffness"}), always_fitted=[], starts=1
    )
    found = diagnose(
        EstimatedSimulator.exact(oscillator()), [CASES["linear_stiffness"][0]()], config
    ).diagnosis
    assert found.candidates[0].parameters["ratio"].value == pytest.approx(1.2, rel=0.02)
