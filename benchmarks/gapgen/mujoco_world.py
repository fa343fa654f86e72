"""Mechanisms that MuJoCo moves, with the withheld effects in MuJoCo's own terms where it has them.

Viscous damping, springs, dry friction, inertia, stops and gains of inputs are damping, stiffness,
frictionloss, armature, limited ranges and gears of the model. Every other law is a force at the middle of
each step, to which the state is extrapolated; internal states follow by the midpoint rule.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property

import mujoco
import numpy as np
from numpy.typing import NDArray

from benchmarks.gapgen import laws
from benchmarks.gapgen.effect import Effect
from benchmarks.gapgen.mechanisms import Mechanism, draw_spread
from benchmarks.gapgen.motion import CORNERED, SHARP, World
from benchmarks.gapgen.mujoco_steps import run_mujoco, stepping_functions

Array = NDArray[np.float64]
PENDULUM, CART, TWO_LINK, CART_POLE = 20, 21, 22, 23
MUJOCO = ("mujoco_pendulum", "mujoco_cart", "mujoco_two_link", "mujoco_cart_pole")
# laws that are fields of the model; those of friction and drift are set anew before each step
IN_MODEL = (laws.VISCOUS, laws.SPRING, laws.INERTIA, laws.STOP, laws.PAYLOAD, laws.MASSES, laws.SERVO)
LIMIT_IMPEDANCE = 0.9

HEAD = """<mujoco><compiler angle="radian" autolimits="false"/><size memory="64K"/>
<option integrator="RK4" gravity="0 0 -9.81"><flag contact="disable" autoreset="disable"/></option>
<worldbody>"""
BODIES = {
    PENDULUM: """<body><joint name="a" axis="0 -1 0" damping="{4!r}"/>
<geom type="sphere" size="{2!r}" mass="{0!r}" pos="0 0 {n1!r}"/>
<geom type="capsule" size="0.004" mass="{3!r}" fromto="0 0 0 0 0 {n1!r}"/></body>""",
    CART: """<body><joint name="a" type="slide" axis="1 0 0" damping="{1!r}" stiffness="{2!r}"/>
<geom type="box" size="0.06 0.04 0.03" mass="{0!r}"/></body>""",
    TWO_LINK: """<body><joint name="a" axis="0 -1 0" stiffness="{5!r}" damping="{7!r}"/>
<geom type="capsule" size="{4!r}" mass="{0!r}" fromto="0 0 0 0 0 {n2!r}"/>
<body pos="0 0 {n2!r}"><joint name="b" axis="0 -1 0" stiffness="{6!r}" damping="{8!r}"/>
<geom type="capsule" size="{4!r}" mass="{1!r}" fromto="0 0 0 0 0 {n3!r}"/></body></body>""",
    CART_POLE: """<body><joint name="a" type="slide" axis="1 0 0" stiffness="{3!r}" damping="{4!r}"/>
<geom type="box" size="0.06 0.04 0.03" mass="{0!r}"/>
<body><joint name="b" axis="0 -1 0" damping="{5!r}"/>
<geom type="capsule" size="0.01" mass="{1!r}" fromto="0 0 0 0 0 {n2!r}"/></body></body>""",
}
DAMPING = {PENDULUM: [4], CART: [1], TWO_LINK: [7, 8], CART_POLE: [4, 5]}


def write_mjcf(kind: int, p: Array, b: Array, kv: Array | None = None) -> str:
    """The model of a mechanism of parameters ``p`` (n_p,), with a motor for each column of ``b`` (d, n_u).

    With ``kv`` (n_u,) these are position actuators, whose kp is in ``b``.
    """
    numbers = [float(x) for x in p]
    body = BODIES[kind].format(*numbers, **{f"n{k}": -x for k, x in enumerate(numbers)})
    motors = []
    for j, column in enumerate(b.T):
        i = int(np.flatnonzero(column)[0])
        if kv is not None:
            motors.append(f'<position joint="{"ab"[i]}" kp="{float(column[i])!r}" kv="{float(kv[j])!r}"/>')
            continue
        motors.append(f'<motor joint="{"ab"[i]}" gear="{float(column[i])!r}"/>')
    return f"{HEAD}{body}</worldbody><actuator>{''.join(motors)}</actuator></mujoco>"


@dataclass(frozen=True)
class MujocoMechanism(Mechanism):
    """A mechanism whose parameters ``p`` are masses, lengths, springs and damping of a MuJoCo model.

    Every column of ``b`` (d, n_u) has one entry, the gear of a motor, or with ``kv`` (n_u,) the gain of a
    position actuator with that damping.
    """

    kv: Array | None = None

    def build(self) -> mujoco.MjModel:
        """A fresh model with these parameters."""
        return mujoco.MjModel.from_xml_string(write_mjcf(self.kind, self.p, self.b, self.kv))

    def loaded_inertia(self) -> Array:
        """Inertia at rest, (d, d), with a kilogram more on the body of the first joint."""
        model = self.build()
        model.body_mass[1] += 1.0
        mujoco.mj_setConst(model, mujoco.MjData(model))
        return _inertia_of(model)

    def base_pull(self) -> Array:
        """Generalised forces (d,) by which it resists a unit acceleration of the base along x, at rest."""
        model = self.build()
        model.opt.gravity[:] = -1.0, 0.0, 0.0
        data = mujoco.MjData(model)
        mujoco.mj_forward(model, data)
        return data.qfrc_bias.copy()

    def damping_at_rest(self) -> Array:
        """Damping force of every coordinate at unit speed of all, (d,)."""
        return self._at_rest[2]

    def _damping_slots(self) -> list[int]:
        return DAMPING[self.kind]

    def _linear(self) -> tuple[Array, Array]:
        return self._at_rest[0].copy(), self._at_rest[1].copy()

    @cached_property
    def _at_rest(self) -> tuple[Array, Array, Array]:
        model = self.build()
        data = mujoco.MjData(model)
        stiffness = np.zeros((self.d, self.d))
        for j in range(self.d):
            h = 1e-4 * self.size[j]
            for sign in (1.0, -1.0):
                data.qpos[:] = 0.0
                data.qpos[j] = sign * h
                mujoco.mj_forward(model, data)
                held = data.qfrc_bias - data.qfrc_passive - data.qfrc_actuator
                stiffness[:, j] += sign * held / (2.0 * h)
        damping = model.dof_damping.copy()
        if self.kv is not None:
            damping += np.abs(np.sign(self.b)) @ self.kv
        return _inertia_of(model), stiffness, damping


def _inertia_of(model: mujoco.MjModel) -> Array:
    """Inertia at rest, (d, d): its columns are what unit accelerations take."""
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    columns = []
    for unit in np.eye(model.nv):
        column = np.zeros(model.nv)
        mujoco.mj_mulM(model, data, column, unit)
        columns.append(column)
    return np.stack(columns, axis=1)


class MujocoWorld(World):
    """A mechanism of MuJoCo and its effects; moves and forecasts as :class:`World` does."""

    operators_of_model = ("gain",)

    def __post_init__(self) -> None:
        super().__post_init__()
        self.model = self.mechanism.build()
        self.data = mujoco.MjData(self.model)
        put_into_model(self.model, self.effects, self.inertia, self.own_hz)
        self.stiffness = np.diag(self.mechanism.stiffness_at_rest()).copy()
        by_step = np.array([law not in IN_MODEL for law in self.which[:, 0]], bool)
        self.stepped = (np.ascontiguousarray(self.which[by_step]), np.ascontiguousarray(self.how[by_step]))
        m, d = self.model, self.data
        self.fields = (d.qpos, d.qvel, d.qacc, d.qacc_warmstart, d.qfrc_applied, d.ctrl, d.qfrc_bias)
        self.fields += (d.qfrc_spring, d.qfrc_actuator, m.dof_frictionloss, m.jnt_stiffness, m.opt.gravity)

    def _load(self) -> Mechanism:
        return self.mechanism

    def n_sub(self, dt_s: float) -> int:
        """Integration steps in a sample."""
        step = (3e-3 if self.effects else 6e-3) / self.top_hz
        for law, i, _, _ in self.which:
            # the drive that a motor limits is that of the step before
            if law in (laws.BRISTLE, laws.MOTOR):
                step = min(step, 6e-4 / self.own_hz[i])
            elif law in SHARP or law in CORNERED:
                step = min(step, 1e-3 / self.own_hz[i])
        return max(1, int(np.ceil(dt_s / step)))

    def _run(self, x0: Array, t0: float, dt_s: float, n: int, n_sub: int, fine: Array) -> Array:
        self.model.opt.timestep = dt_s / n_sub
        step, forward = stepping_functions()
        where = (self.model._address, self.data._address)
        bound = 15.0 * self.mechanism.size
        scales = (self.inertia, self.stiffness, bound)
        return run_mujoco(
            step, forward, where, self.fields, scales, *self.stepped, x0, t0, dt_s, n, n_sub, fine
        )

    def _forecasts(
        self,
        x0: Array,
        starts: NDArray[np.int64],
        t0: float,
        dt_s: float,
        burn: int,
        n: int,
        n_sub: int,
        fine: Array,
        y: Array,
    ) -> Array:
        d = self.mechanism.d
        out = np.empty((len(starts), n, d))
        for k, a in enumerate(starts):
            window = fine[2 * n_sub * a : 2 * n_sub * (a + n - 1) + 1]
            t = t0 + a * dt_s

            def moved(x: Array, many: int, t: float = t, window: Array = window) -> Array:
                return self._run(x, t, dt_s, many, n_sub, window)

            out[k] = moved(fit_start(moved, x0[k], y[a : a + burn], dt_s), n)[:, :d]
        return out


def fit_start(moved: Callable[[Array, int], Array], x0: Array, y: Array, dt_s: float) -> Array:
    """State (n_x,) whose motion fits the samples ``y`` (m, d) best; ``moved`` gives m states from one.

    Gauss-Newton steps from ``x0`` with the Jacobian of the first guess; internal states stay.
    """
    m, d = y.shape
    x, best, least = x0.copy(), x0.copy(), np.inf
    jacobian = np.empty((m * d, 2 * d))
    for k in range(4):
        base = moved(x, m)[:, :d]
        cost = float(((y - base) ** 2).sum())
        if not cost < least:
            # back half way: the step crossed a corner of a law
            x = 0.5 * (x + best)
            continue
        gained = least - cost
        best, least = x.copy(), cost
        if k == 3 or gained < 1e-3 * cost:
            break
        if k == 0:
            for j in range(2 * d):
                there = x.copy()
                step = 1e-5 * (1.0 + abs(x[j]))
                there[j] += step
                jacobian[:, j] = ((moved(there, m)[:, :d] - base) / step).ravel()
            normal = jacobian.T @ jacobian
            # a mechanism that sticks does not feel its first speed
            normal += 1e-5 * np.trace(normal) * min(dt_s * m, 1.0) ** 2 * np.eye(2 * d)
        x = x.copy()
        x[: 2 * d] += np.linalg.solve(normal, jacobian.T @ (y - base).ravel())
    return best


def put_into_model(model: mujoco.MjModel, effects: list[Effect], inertia: Array, own_hz: Array) -> None:
    """Set the fields of a model that stand for laws; ``inertia`` and ``own_hz`` (d,) are those at rest."""
    for effect in effects:
        for law, i, j, th in effect.rows:
            if law == laws.VISCOUS:
                model.dof_damping[i] += th[0] * inertia[i]
            elif law == laws.SPRING:
                model.jnt_stiffness[i] += th[0] * inertia[i]
            elif law == laws.INERTIA:
                model.dof_armature[i] += th[0] * inertia[i]
            elif law == laws.PAYLOAD:
                model.body_mass[1 + i] += th[0]
            elif law == laws.MASSES:
                model.body_mass *= th[0]
                model.body_inertia *= th[0]
            elif law == laws.SERVO:
                model.actuator_gainprm[j, 0] += th[0] * inertia[i]
                model.actuator_biasprm[j, 1] -= th[0] * inertia[i]
                model.actuator_biasprm[j, 2] -= th[1] * inertia[i]
            elif law == laws.FRICTION:
                # so short that friction is full at speeds far below those of the motion
                model.dof_solref[i] = 4e-3 / own_hz[i], 1.0
            elif law == laws.STOP:
                _put_stop(model, i, th, effect.parameters.get("stiffness_ratio", 15.0), own_hz[i])
        for j, name, numbers in effect.operators:
            if name == "gain":
                model.actuator_gear[j, 0] *= numbers["ratio"]
    mujoco.mj_setConst(model, mujoco.MjData(model))


def _put_stop(model: mujoco.MjModel, i: int, th: list[float], ratio: float, own_hz: float) -> None:
    """A limit of the joint as hard as Hunt and Crossley's law is where its stiffness is the truth's."""
    side, place, hard, loss = th
    stiffness = ratio * (2.0 * np.pi * own_hz) ** 2
    depth = (stiffness / hard) ** 2
    model.jnt_limited[i] = 1
    model.jnt_range[i] = (-1e3, place) if side > 0 else (place, 1e3)
    model.jnt_solref[i] = -stiffness, -stiffness * depth * loss
    model.jnt_solimp[i] = LIMIT_IMPEDANCE, LIMIT_IMPEDANCE, 1e-3, 0.5, 2.0


def _pendulum(rng: np.random.Generator) -> MujocoMechanism:
    mass, length, radius = draw_spread(rng, 0.6, 0.6), draw_spread(rng, 0.28, 0.4), rng.uniform(0.02, 0.05)
    omega = np.sqrt(9.81 / length)
    c = 2.0 * rng.uniform(0.008, 0.04) * omega * mass * length**2
    p = np.array([mass, length, radius, mass * rng.uniform(0.02, 0.4), c])
    size = np.array([rng.uniform(0.5, 1.0)])
    return MujocoMechanism("mujoco_pendulum", PENDULUM, 1, p, np.array([[1.0]]), size)


def _cart(rng: np.random.Generator) -> MujocoMechanism:
    mass, omega = draw_spread(rng, 0.8, 0.7), 2.0 * np.pi * rng.uniform(0.6, 1.6)
    c = 2.0 * rng.uniform(0.01, 0.05) * omega * mass
    size = np.array([draw_spread(rng, 0.12, 0.7)])
    return MujocoMechanism(
        "mujoco_cart", CART, 1, np.array([mass, c, mass * omega**2]), np.array([[1.0]]), size
    )


def _two_link(rng: np.random.Generator) -> MujocoMechanism:
    masses = np.array([draw_spread(rng, 0.8, 0.4), draw_spread(rng, 0.5, 0.4)])
    lengths = np.array([draw_spread(rng, 0.3, 0.3), draw_spread(rng, 0.25, 0.3)])
    reference = np.array([masses.sum() * lengths.sum() ** 2, masses[1] * lengths[1] ** 2]) / 3.0
    omega2 = 9.81 / lengths.sum()
    springs = reference * omega2 * rng.uniform(0.0, 2.0, 2)
    c = 2.0 * rng.uniform(0.008, 0.03, 2) * np.sqrt(omega2) * reference
    p = np.array([*masses, *lengths, rng.uniform(0.01, 0.03), *springs, *c])
    size = np.array([rng.uniform(0.2, 0.4), rng.uniform(0.25, 0.5)])
    return MujocoMechanism("mujoco_two_link", TWO_LINK, 2, p, np.diag(reference / reference[0]), size)


def _cart_pole(rng: np.random.Generator) -> MujocoMechanism:
    cart, pole, length = draw_spread(rng, 1.2, 0.4), draw_spread(rng, 0.3, 0.5), draw_spread(rng, 0.5, 0.4)
    omega = np.sqrt(1.5 * 9.81 / length)
    k = (cart + pole) * (omega * rng.uniform(0.6, 1.6)) ** 2
    inertia = np.array([cart + pole, pole * length**2 / 3.0])
    c = 2.0 * rng.uniform(0.008, 0.04, 2) * omega * inertia
    p = np.array([cart, pole, length, k, *c])
    size = np.array([length * rng.uniform(0.1, 0.25), rng.uniform(0.25, 0.6)])
    b = np.diag([1.0, 0.5 * length * pole / (cart + pole)])
    return MujocoMechanism("mujoco_cart_pole", CART_POLE, 2, p, b, size)


def draw_mujoco(system: str, rng: np.random.Generator) -> MujocoMechanism:
    """A nominal mechanism of one of the systems ``MUJOCO``."""
    makers = dict(zip(MUJOCO, (_pendulum, _cart, _two_link, _cart_pole), strict=True))
    return makers[system](rng)
