"""Simulate the true answer to a known force on a known point of a system, as its camera sees it.

Forces are given in the image, as energy per pixel [J/px]: such a force does the work ``f.dx`` over a
displacement ``dx`` [px] of its point. Where the image is parallel to the motion it is the force in newton
times the metres per pixel.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
from jaxtyping import Float64
from scipy.integrate import solve_ivp

from lagsplat.systems import chain
from lagsplat.systems.arm import build_arm
from lagsplat.systems.config import ReleaseConfig, SimulationConfig
from lagsplat.systems.mechanism import find_rest_state, make_mechanism
from lagsplat.systems.rendering.painting import TOP
from lagsplat.systems.rendering.textures import SHAPES, Sprite
from lagsplat.systems.truth import STEP, Matrix, Series, Vector, compute_stiffness
from lagsplat.systems.video import make_camera

COVERED = 0.5
ITERATIONS = 40
LONGEST = 0.2
SETTLED = 1e-8


@dataclass(frozen=True)
class Pushable:
    """Equations of motion in the true coordinates, and ``P`` material points spread over the bodies.

    ``pixels`` gives their places (T, P, 2) [px] at states (T, d), in pixels of the recording; ``share`` (P,)
    is the mass [kg] that each represents. ``force`` is the generalised force at rest of weight, springs and
    constant inputs; ``acceleration`` takes position, velocity and an external generalised force.
    """

    rest: Vector
    force: Callable[[Vector], Vector]
    acceleration: Callable[[Vector, Vector, Vector], Vector]
    mass: Callable[[Vector], Matrix]
    pixels: Callable[[Series], Float64[np.ndarray, "T P 2"]]
    share: Float64[np.ndarray, " P"]

    def jacobian(self, q: Vector) -> Float64[np.ndarray, "P 2 d"]:
        """Derivative of the points' places in the image [px per unit of each coordinate]."""
        nearby = q + STEP * np.concatenate([np.eye(len(q)), -np.eye(len(q))])
        ahead, behind = np.split(self.pixels(nearby), 2)
        return np.moveaxis((ahead - behind) / (2 * STEP), 0, 2)

    def stiffness(self, q: Vector) -> Matrix:
        """Minus the derivative of ``force``."""
        return compute_stiffness(self.force, q)

    def settled(self, point: int, forces: Float64[np.ndarray, "n 2"]) -> Float64[np.ndarray, "n d"]:
        """Equilibria under a force on one point that grows from row to row [J/px].

        Newton's method starts each row from the last, and so follows the branch that starts at rest. A row
        without a stable equilibrium is NaN, as after tipping over, and so are those after it.
        """
        equilibria = np.full((len(forces), len(self.rest)), np.nan)
        q = self.rest
        for i, force in enumerate(forces):
            q = self._balanced(q, point, force)
            if not np.isfinite(q).all():
                break
            equilibria[i] = q
        return equilibria

    def _balanced(self, q: Vector, point: int, force: Float64[np.ndarray, "2"]) -> Vector:
        def left(x: Vector) -> Vector:
            return self.force(x) + force @ self.jacobian(x)[point]

        for _ in range(ITERATIONS):
            slope = compute_stiffness(left, q)
            step = np.linalg.solve(slope, left(q)) if np.isfinite(slope).all() else np.full(len(q), np.nan)
            q = q + np.clip(step, -LONGEST, LONGEST)
            if not np.isfinite(q).all():
                break
            if np.abs(step).max() < SETTLED:
                stable = np.linalg.eigvalsh(0.5 * (slope + slope.T))[0] > 0
                return q if stable else np.full(len(q), np.nan)
        return np.full(len(q), np.nan)

    def moved(
        self, point: int, force: Float64[np.ndarray, "2"], *, time_s: Float64[np.ndarray, " T"]
    ) -> Series:
        """States at ``time_s`` after a force on one point is switched on at the first of them, from rest.

        Raises:
            RuntimeError: the solver failed.
        """
        d = len(self.rest)

        def rate(_: float, state: np.ndarray) -> np.ndarray:
            q, v = state[:d], state[d:]
            return np.concatenate([v, self.acceleration(q, v, force @ self.jacobian(q)[point])])

        solution = solve_ivp(
            rate,
            (time_s[0], time_s[-1]),
            np.concatenate([self.rest, np.zeros(d)]),
            method="RK45",
            t_eval=time_s,
            rtol=1e-6,
            atol=1e-9,
            max_step=0.05,
        )
        if not solution.success:
            raise RuntimeError(f"the pushed system could not be integrated: {solution.message}")
        return np.ascontiguousarray(solution.y[:d].T)


def make_pushable(
    driven: SimulationConfig | None,
    released: ReleaseConfig | None,
    *,
    pressure: Float64[np.ndarray, " n_u"],
    points: int,
) -> Pushable:
    """The simulated arm or mechanism behind a recording, with ``points`` by ``points`` on each body.

    ``pressure`` [atm] is constant; a released mechanism has none.

    Raises:
        ValueError: neither system is given, or it has no rest state.
    """
    if driven is not None:
        return _arm(driven, pressure, points)
    if released is not None:
        return _mechanism(released, points)
    raise ValueError("the truth of a force is known of simulated systems alone; choose recording=simulated")


def _mechanism(config: ReleaseConfig, points: int) -> Pushable:
    mechanism, camera = make_mechanism(config), make_camera(config)
    masses = config.linkage.masses if config.linkage else []
    if config.rocker:
        masses = [config.rocker.body_mass]
    bodies, places, depth, share = [], [], [], []
    for number, (body, mass) in enumerate(zip(config.bodies, masses, strict=True)):
        on = _covered(SHAPES[body.shape](body.size_m, camera.focal[0] / config.scene.distance), points)
        bodies += [number] * len(on)
        places += on
        depth += [-0.5 * body.thickness_m if body.layers > 1 else 0.0] * len(on)
        share += [mass / len(on)] * len(on)
    places_m, z = np.array(places) @ np.array([1.0, 1.0j]), np.array(depth)

    def pixels(states: Series) -> Float64[np.ndarray, "T P 2"]:
        x, y, angle = np.moveaxis(mechanism.poses(states)[:, bodies], 2, 0)
        turned = places_m * np.exp(1j * angle)
        world = np.stack([x + turned.real, y + turned.imag, np.broadcast_to(z, x.shape)], axis=2)
        return camera.project(world.reshape(-1, 3)).reshape(*x.shape, 2) / config.scene.film_scale

    return Pushable(
        find_rest_state(mechanism),
        mechanism.static_force,
        mechanism.acceleration,
        mechanism.mass,
        pixels,
        np.array(share),
    )


def _covered(sprite: Sprite, points: int) -> list[tuple[float, float]]:
    """Points [m] in a body's coordinates, on a grid over its extent, where its sprite is opaque."""
    cover = sprite.rgba[:, :, 3]
    rows, columns = (np.flatnonzero((cover > COVERED).any(axis)) for axis in (1, 0))
    middles = (np.arange(points) + 0.5) / points
    grid = [
        (int(rows[0] + a * (rows[-1] - rows[0])), int(columns[0] + b * (columns[-1] - columns[0])))
        for a in middles
        for b in middles
    ]
    return [
        ((j + 0.5 - sprite.origin[0]) / sprite.scale, (i + 0.5 - sprite.origin[1]) / sprite.scale)
        for i, j in grid
        if cover[i, j] > COVERED
    ]


def _arm(config: SimulationConfig, pressure: Float64[np.ndarray, " n_u"], points: int) -> Pushable:
    arm = build_arm(config.arm)
    n, middles = arm.d // 2, (np.arange(points) + 0.5) / points
    across = config.arm.half_width * np.array([-0.6, 0.0, 0.6])
    segment, s, offset = (x.ravel() for x in np.meshgrid(np.arange(n), middles, across, indexing="ij"))
    table, per_px = arm.table, config.view_width / config.width

    def pixels(states: Series) -> Float64[np.ndarray, "T P 2"]:
        place = np.zeros((len(states), len(s)), complex)
        base, heading = np.zeros(len(states), complex), np.ones(len(states), complex)
        for i in range(n):
            bend, length = states[:, 2 * i], table[i, chain.LENGTH] * (1 + states[:, 2 * i + 1])
            on = segment == i
            inside = np.stack([_arcs(bend, share) for share in s[on]], axis=1)
            normal = 1j * heading[:, None] * np.exp(1j * bend[:, None] * s[on])
            place[:, on] = (base + 0j)[:, None] + (heading * length)[:, None] * inside + offset[on] * normal
            base = base + heading * length * _arcs(bend, 1.0)
            heading = heading * np.exp(1j * bend)
            base = base + heading * table[i, chain.LINK_LENGTH]
        right, down = place.imag + 0.5 * config.view_width, place.real + TOP * config.view_width
        return np.stack([right, down], axis=2) / per_px

    def acceleration(q: Vector, v: Vector, push: Vector) -> Vector:
        return arm.acceleration(q, v, pressure) + np.linalg.solve(arm.mass(q), push)

    masses = table[:, chain.MASS] + table[:, chain.LINK_MASS]
    return Pushable(
        arm.equilibrium(pressure),
        lambda q: arm.static_force(q, pressure),
        acceleration,
        arm.mass,
        pixels,
        masses[segment] / (points * len(across)),
    )


def _arcs(bend: Float64[np.ndarray, " T"], share: float) -> np.ndarray:
    return np.array([chain.arc_points(float(angle), share)[0] for angle in bend])
