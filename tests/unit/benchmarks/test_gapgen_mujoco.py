"""Motions that MuJoCo computes, against closed forms and against the generator's own equations."""

import numpy as np
import pytest

from benchmarks.gapgen import laws
from benchmarks.gapgen.effect import Effect
from benchmarks.gapgen.mechanisms import CART, Mechanism
from benchmarks.gapgen.motion import Plan, World
from benchmarks.gapgen.mujoco_world import CART as MUJOCO_CART
from benchmarks.gapgen.mujoco_world import MUJOCO, PENDULUM, MujocoMechanism, MujocoWorld, draw_mujoco

ONE = np.array([[1.0]])


def cart(*, mass: float = 2.0, c: float = 0.0, k: float = 80.0) -> MujocoMechanism:
    return MujocoMechanism("mujoco_cart", MUJOCO_CART, 1, np.array([mass, c, k]), ONE, np.array([0.2]))


def free(x0: list[float], n: int, dt: float = 0.01) -> Plan:
    return Plan(dt, [0.0], [np.array(x0)], [0], [np.zeros((n, 1))])


def test_a_pendulum_swings_and_decays_as_its_formula_says() -> None:
    mass, length, radius, c = 0.5, 0.3, 0.04, 0.02
    p = np.array([mass, length, radius, 1e-9, c])
    m = MujocoMechanism("mujoco_pendulum", PENDULUM, 1, p, ONE, np.array([0.5]))
    inertia = mass * (length**2 + 0.4 * radius**2)
    omega = np.sqrt(mass * 9.81 * length / inertia)
    assert m.inertia_at_rest()[0, 0] == pytest.approx(inertia, rel=1e-6)
    assert m.frequencies_hz()[0] == pytest.approx(omega / (2 * np.pi), rel=1e-6)
    x = MujocoWorld(m).move(free([0.01, 0.0], 1000))[0].x[:, 0]
    t, decay = np.arange(1000) * 0.01, 0.5 * c / inertia
    swing = np.sqrt(omega**2 - decay**2)
    expected = 0.01 * np.exp(-decay * t) * (np.cos(swing * t) + decay / swing * np.sin(swing * t))
    assert np.abs(x - expected).max() < 2e-5


def test_its_own_friction_takes_as_much_in_every_swing() -> None:
    level, omega2 = 0.5, 40.0
    effect = Effect("coulomb_friction", [(laws.FRICTION, 0, 0, [level, level, 1.0, 0.0, 1.0])])
    x = MujocoWorld(cart(), [effect]).move(free([0.2, 0.0], 1000))[0].x
    turns = np.flatnonzero((x[1:-1, 0] - x[:-2, 0]) * (x[2:, 0] - x[1:-1, 0]) < 0) + 1
    heights = np.abs(x[turns, 0])
    expected = 0.2 - 2.0 * level / omega2 * np.arange(1, 6)
    assert np.abs(heights[:5] - expected).max() < 3e-3
    assert np.ptp(x[-50:, 0]) < 1e-4


def test_its_own_stop_is_not_passed_by_far() -> None:
    hard, omega2 = 20.0, 40.0
    numbers = [1.0, 0.1, hard * omega2 / np.sqrt(0.01), 0.2]
    effect = Effect("end_stop", [(laws.STOP, 0, 0, numbers)], parameters={"stiffness_ratio": hard})
    x = MujocoWorld(cart(), [effect]).move(free([-0.2, 0.0], 400))[0].x
    speed = np.sqrt(omega2 * (0.2**2 - 0.1**2))
    assert 0.1 < x[:, 0].max() < 0.1 + speed / np.sqrt(hard * omega2)
    assert x[:, 0].min() > -0.2 - 1e-6


@pytest.mark.parametrize(
    ("law", "numbers"),
    [
        (laws.VISCOUS, [1.0, 1.0, 0.5]),
        (laws.SPRING, [15.0]),
        (laws.INERTIA, [0.3]),
        (laws.CONSTANT, [1.5]),
        (laws.HARDENING, [300.0, 0.2]),
        (laws.BRISTLE, [0.3, 0.6, 0.1, 1.0, 4.0, 0.0, 2e-3, 8.0]),
        (laws.DRAG, [2.0, 2.2, 0.5]),
        (laws.SLIP_CHAIN, [0.4, 0.05]),
        (laws.CREEP, [12.0, 0.1, 0.4, 0.5]),
        (laws.FREE_PLAY, [40.0, 0.05, 0.01, 0.8]),
        (laws.PUSH, [1.0, 0.4, 3.0, 2.0, 0.3, -2.0, 0.0, 0.0, 0.0]),
        (laws.PERIODIC, [1.0, 9.0, 0.3, 0.05]),
        (laws.DRIFT_POTENTIAL, [0.05, 6.0]),
        (laws.ABSORBER, [9.0, 0.1, 0.03, 0.0]),
        (laws.INPUT_STIFFNESS, [10.0, 0.0]),
        (laws.SELF_EXCITED, [0.5, 0.1]),
        (laws.TEETH, [0.6, 60.0, 0.3, 0.2]),
        (laws.MESH, [0.3, 9.0, 0.4, 40.0, 1.2]),
        (laws.LIP_SEAL, [0.4, 0.1, 0.1]),
        (laws.FRACTIONAL, [6.0, 0.01, 5.0, 0.5]),
        (laws.BELT, [0.5, 0.3, 0.2]),
        (laws.SPEED_SOFTENING, [20.0, 0.4]),
        (laws.MOTOR, [0.9, 0.8, 0.2, 0.5]),
        (laws.BASE, [0.6, 9.0, 0.3, 0.05]),
        (laws.PAYLOAD, [0.4]),
        (laws.MASSES, [1.2]),
    ],
)
def test_every_law_acts_as_in_the_own_equations(law: int, numbers: list[float]) -> None:
    effects = [
        Effect("any", [(law, 0, 0, numbers)]),
        Effect("input_gain", operators=[(0, "gain", {"ratio": 1.3})]),
    ]
    own = Mechanism("linear_cart", CART, 1, np.array([2.0, 0.3, 80.0, 0.0]), ONE, np.array([0.2]))
    u = 2.0 * np.sin(5.0 * np.arange(400) * 0.01)[:, None]
    plan = Plan(0.01, [0.0], [np.array([0.1, 0.0])], [0], [u])
    expected = World(own, effects).move(plan)[0].x[:, 0]
    if law == laws.INPUT_STIFFNESS:
        # of MuJoCo's input before its gear
        effects[0].rows[0][3][0] *= 1.3
    found = MujocoWorld(cart(c=0.3), effects).move(plan)[0].x[:, 0]
    assert np.abs(found - expected).max() < 2e-3 * np.abs(expected).max()


@pytest.mark.parametrize("system", MUJOCO)
def test_forecasts_hit_what_they_come_from_and_perturbed_ones_miss(system: str) -> None:
    m = draw_mujoco(system, np.random.default_rng(2))
    x0 = np.concatenate([0.8 * m.size, np.zeros(m.d)])
    plan = Plan(0.02, [0.0], [x0], [0], [np.zeros((150, m.n_u))])
    clips = MujocoWorld(m).move(plan)
    ys = [clip.x[:, : m.d] for clip in clips]

    def off(world: World) -> float:
        return max(
            float(np.abs(y_hat - np.stack([ys[k][a : a + 60] for a in starts])).max())
            for k, starts, y_hat in world.forecast(clips, ys, 0.02, 60, 4)
        )

    right = off(MujocoWorld(m))
    wrong = off(MujocoWorld(m.perturbed(np.random.default_rng(1), 0.05)))
    assert right < 1e-3 * m.size.max() < wrong


def test_its_position_actuator_is_a_spring_to_a_target_with_damping() -> None:
    """Also where its gains differ."""
    kp, kd = np.array([[30.0]]), np.array([1.5])
    changed = [Effect("controller_gain", [(laws.SERVO, 0, 0, [4.0, 0.3])])]
    own = Mechanism("linear_cart", CART, 1, np.array([2.0, 1.8, 110.0, 0.0]), kp, np.array([0.2]))
    m = MujocoMechanism("mujoco_cart", MUJOCO_CART, 1, np.array([2.0, 0.3, 80.0]), kp, np.array([0.2]), kd)
    assert m.stiffness_at_rest()[0, 0] == pytest.approx(110.0, rel=1e-6)
    assert m.damping_at_rest()[0] == pytest.approx(1.8)
    target = 0.2 * np.sin(5.0 * np.arange(400) * 0.01)[:, None]
    plan = Plan(0.01, [0.0], [np.array([0.1, 0.0])], [0], [target])
    for effects in ([], changed):
        found, expected = (world.move(plan)[0].x for world in (MujocoWorld(m, effects), World(own, effects)))
        assert np.abs(found - expected).max() < 2e-3 * np.abs(expected).max()


def test_what_escapes_is_said() -> None:
    pushed = [Effect("any", [(laws.SPRING, 0, 0, [-120.0])])]
    with pytest.raises(FloatingPointError, match="left every bound"):
        MujocoWorld(cart(), pushed).move(free([0.1, 0.0], 600))
