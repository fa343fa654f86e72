"""Effects of machines against models in which the same is written as another parameter."""

from dataclasses import replace

import numpy as np
import pytest

from lagsplat.diagnose.augmented.model import AugmentedSimulator
from lagsplat.diagnose.augmented.simulate import AppliedSignals, simulate_augmented
from lagsplat.diagnose.effects.base import Direction, DisturbanceHints, PlacedEffect, PlaceFinder
from lagsplat.diagnose.effects.parameters import Scales
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.estimation.dataset import OperatingRegion
from lagsplat.diagnose.inference.placement import find_common_line, place_effects
from lagsplat.diagnose.mechanics.basis import add_angle_functions, make_polynomial_basis
from lagsplat.diagnose.mechanics.model import MechanicalModel
from tests.unit.diagnose.residuals import made
from tests.unit.diagnose.toys import GAIN, RATE, bare, contest, coupled, film, oscillator, wave

SCALES = Scales(
    coordinate=0.5, velocity=3.0, reach=1.0, frame_s=0.01, duration_s=4.0, stiffness=36.0, drive=4.0
)
TIME = np.arange(300) * 0.01


def region(model: MechanicalModel) -> OperatingRegion:
    return OperatingRegion(*(np.zeros((4, n)) for n in (model.d, model.d, model.n_u)))


def added(
    model: MechanicalModel, name: str, values: dict[str, float], along: Direction, variant: str = "", **more
) -> AugmentedSimulator:
    one, effect = bare(model, region(model), step_s=0.002, dt_s=0.01), catalogue()[name]
    place = PlacedEffect(effect, SCALES, variant, along, **more)
    x = []
    for p in effect.parameters:
        value = np.log(values[p.name]) if p.kind == "log_ratio" else values[p.name] / SCALES.of(p.kind)
        x.append(p.prior.unknown(float(value)))
    return replace(one, effects=(place,), x=np.concatenate([x, one.x]))


def moved(one: AugmentedSimulator, q: list[float], v: list[float] | None = None) -> np.ndarray:
    u = np.stack([2.0 * np.sin(4.0 * TIME + c) for c in range(one.model.n_u)], axis=1).reshape(len(TIME), -1)
    signals = AppliedSignals(TIME, u)
    return simulate_augmented(one, signals, q=np.array(q), v=None if v is None else np.array(v))[0]


def pendulum(mass: float, length: float) -> MechanicalModel:
    """A point mass on a light rod, with another inertia of its own, about the hanging rest."""
    basis = add_angle_functions(
        make_polynomial_basis(2, centre=np.zeros(1), scale=np.ones(1)), np.array([[1]])
    )
    potential = np.zeros(basis.size)
    potential[3] = -9.81 * mass * length
    still = np.zeros(1)
    inertia, damping, gain = (
        np.full((1, 1, 1), mass * length**2),
        np.full((1, 1, 1), 0.05),
        np.full((1, 1, 1), 0.2),
    )
    return MechanicalModel(basis, inertia, damping, potential, gain, still, still, np.full(1, 0.1), still)


def test_a_payload_on_a_pendulum_is_another_pendulum() -> None:
    kg, far = 0.3, 0.6
    own = pendulum(1.0, 0.4)
    inertia = 0.16
    ratio = kg * far**2 / inertia
    loaded = replace(own, mass=own.mass * (1.0 + ratio))
    loaded = replace(loaded, potential=own.potential * (1.0 + kg * far / 0.4))
    along = Direction.of("q0", np.ones(1), own)
    values = {"mass_ratio": ratio, "weight": (kg * far / 0.4) / ratio, "pull": 0.0}
    ours = moved(added(own, "payload", values, along), [0.9])
    theirs = moved(bare(loaded, region(own), step_s=0.002, dt_s=0.01), [0.9])
    np.testing.assert_allclose(ours, theirs, atol=1e-9)
    assert np.abs(ours - moved(bare(own, region(own), step_s=0.002, dt_s=0.01), [0.9])).max() > 0.05


def test_a_pull_is_a_constant_force_of_the_payload() -> None:
    own = oscillator(hard=0.0)
    along = Direction.of("q0", np.ones(1), own)
    ours = moved(added(own, "payload", {"mass_ratio": 0.5, "weight": 1e-9, "pull": 4.0}, along), [0.3])
    heavy = replace(own, mass=1.5 * own.mass, potential=own.potential - 2.0 * np.eye(5)[1])
    np.testing.assert_allclose(
        ours, moved(bare(heavy, region(own), step_s=0.002, dt_s=0.01), [0.3]), atol=1e-7
    )


def test_gains_of_a_controller_are_those_of_another_one() -> None:
    """The oscillator as a controller of ``kp = GAIN`` beside a spring; its target is the input."""
    own, ratio, kd = oscillator(hard=0.0), 1.6, 0.7
    values, constants = {"kp_ratio": ratio, "kd": kd}, (GAIN, 0.0)
    along = Direction.of("q0", np.ones(1), own)
    ours = moved(added(own, "controller_gain", values, along, channel=0, constants=constants), [0.5])
    potential = own.potential.copy()
    potential[2] += 0.5 * (ratio - 1.0) * GAIN
    other = replace(
        own,
        potential=potential,
        damping=np.full((1, 1, 1), RATE + kd),
        input_map=ratio * own.input_map,
    )
    np.testing.assert_allclose(
        ours, moved(bare(other, region(own), step_s=0.002, dt_s=0.01), [0.5]), atol=1e-9
    )


@pytest.mark.parametrize("variant", ["", "gyroscopic"])
def test_a_force_across_two_coordinates_is_skew(variant: str) -> None:
    model = coupled()
    along = Direction.of("b - a", np.array([-1.0, 1.0]), model)
    one = added(model, "circulatory_force", {"coupling": 0.4}, along, variant)
    unit = SCALES.of("rate") ** (1 if variant else 2)
    strength = 0.4 * unit * np.sqrt(model.inertia[0, 0] * model.inertia[1, 1])
    skew = strength * np.array([[0.0, 1.0], [-1.0, 0.0]])
    plain = bare(model, region(model), step_s=1e-5, dt_s=0.01)
    q, v = np.array([0.3, -0.2]), np.array([1.1, 0.4])
    signals = AppliedSignals(np.array([0.0, 1e-4]), np.zeros((2, 2)))
    rates = [simulate_augmented(replace(each, step_s=1e-5), signals, q=q, v=v)[1] for each in (one, plain)]
    gained = (rates[0][1] - rates[1][1]) / 1e-4
    seen = v if variant else q - model.rest
    np.testing.assert_allclose(gained, np.linalg.solve(model.mass_at(q[None])[0], skew @ seen), rtol=2e-3)


def test_torque_falls_with_speed_in_the_way_of_the_drive_alone() -> None:
    law, memory = catalogue()["torque_speed_limit"].law.__wrapped__, np.zeros(0)  # type: ignore[attr-defined]
    theta, controlled = np.array([6.0, 2.0, 0.0, 0.0]), np.array([6.0, 2.0, 20.0, 0.1])

    def torque(drive: float, v: float, s: float = 0.0, theta: np.ndarray = theta) -> float:
        return drive + law(0.0, s, v, 0.0, drive, memory, theta, memory)

    assert torque(2.0, 0.5) == pytest.approx(2.0)
    assert torque(9.0, 0.0) == pytest.approx(6.0)
    assert torque(9.0, 1.0) == pytest.approx(3.0)
    assert torque(9.0, 3.0) == pytest.approx(0.0)
    assert torque(9.0, -3.0) == pytest.approx(6.0)
    assert torque(-9.0, -1.0) == pytest.approx(-3.0)
    # a controller of gain 20 whose target is 0.5, at 0.4 and at 0.1: what it gives is 2 and 8
    assert torque(10.0, 0.0, 0.3, controlled) == pytest.approx(10.0)
    assert torque(10.0, 0.0, 0.0, controlled) == pytest.approx(10.0 - 2.0)


def test_one_coordinate_of_constant_inertia_has_one_name_for_more_mass() -> None:
    seen = contest([film(u=wave(), seconds=8.0)])
    hints = [DisturbanceHints((), ())]

    def names(model: MechanicalModel) -> set[str]:
        bench = replace(seen.rollout_model, model=model)
        found = place_effects(bench, hints, q_names=("q0",), u_names=("u0",), without=())
        return {one.effect.name for one in found}

    assert "armature" not in names(oscillator())
    varying = np.concatenate([oscillator().mass, np.full((1, 1, 1), 0.1)])
    assert {"armature", "mass_change"} <= names(replace(oscillator(), mass=varying))


def test_a_controller_is_looked_for_where_an_input_is_a_target() -> None:
    seen = contest([film(u=wave(), seconds=8.0)])
    hints = [DisturbanceHints((), ())]

    def places(targets: dict[str, str]) -> list[PlacedEffect]:
        found = place_effects(
            seen.rollout_model, hints, q_names=("q0",), u_names=("u0",), without=(), targets=targets
        )
        return [one for one in found if one.effect.name == "controller_gain"]

    assert places({}) == []
    (one,) = places({"u0": "q0"})
    assert one.channel == 0
    assert one.constants == (pytest.approx(GAIN), 0.0)
    with pytest.raises(ValueError, match="'u7' is the target of 'q0'"):
        places({"u7": "q0"})


def test_a_shaken_base_is_looked_for_along_what_all_coordinates_share() -> None:
    def shaken(t: np.ndarray, q: np.ndarray, v: np.ndarray, u: np.ndarray) -> np.ndarray:
        return np.sin(2.0 * np.pi * 1.62 * t + 0.4) * np.array([3.0, -1.5])

    lines = find_common_line(made(shaken, coordinates=2))
    assert all(line is not None and line[0] == pytest.approx(1.62, abs=0.02) for line in lines)
    shares = [line[1] for line in lines if line is not None]
    assert shares[1] / shares[0] == pytest.approx(-0.5, abs=0.05)
    model, eye = coupled(), np.eye(2)
    finder = PlaceFinder(
        coordinates=tuple(Direction.of(name, eye[i], model) for i, name in enumerate("ab")),
        pairs=(),
        hints=tuple(DisturbanceHints((), (), (), line) for line in lines),
        inputs=(),
        measure=lambda along, variant: SCALES,
        whole=SCALES,
        longest_clips=(),
        constant_inertia=True,
    )
    (place,) = finder.find(catalogue()["base_motion"])
    assert place.direction is not None
    force = place.direction.covector * place.direction.inertia
    assert force[1] / force[0] == pytest.approx(
        shares[1] * model.inertia[1, 1] / (shares[0] * model.inertia[0, 0])
    )
    alone = replace(finder, hints=(finder.hints[0], DisturbanceHints((), (), (), (1.62, 0.0))))
    assert alone.find(catalogue()["base_motion"]) == []


def test_the_natural_rate_is_the_unit_of_a_stiffness_wave() -> None:
    effect = catalogue()["parametric_stiffness"]
    theta = np.array([0.3, 0.0, 5.0, *effect.constants(SCALES, "")])  # type: ignore[attr-defined]
    none = np.zeros(0)
    force = effect.law.__wrapped__(0.0, 0.2, 0.0, 0.0, 0.0, none, theta, none)  # type: ignore[attr-defined]
    assert force == pytest.approx(-0.3 * SCALES.of("rate") ** 2 * 0.2)
