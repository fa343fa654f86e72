"""Simulate the true answer to a known force on a known point of a system, in its picture or in space.

Forces are energies per pixel [J/px]: such a force does the work ``f.dx`` over a displacement ``dx`` [px] of
its point. Where the image is parallel to the motion it is the force in newton times the metres per pixel. In
space, a pixel is a length, see `lagsplat.views.camera.ViewSpace`.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np
from jaxtyping import Complex128, Float64

from lagsplat.systems import chain, dynamics
from lagsplat.systems.arm import build_arm
from lagsplat.systems.config import ReleaseConfig, SimulationConfig
from lagsplat.systems.dynamics import Matrix, Series, Vector
from lagsplat.systems.mechanism import Rocker, find_rest_state, make_mechanism
from lagsplat.systems.rendering.painting import TOP
from lagsplat.systems.rendering.textures import Sprite
from lagsplat.systems.video import draw_bodies, make_camera, make_space

COVERED = 0.5  # opacity from which on a pixel of a sprite belongs to the body


@dataclass(frozen=True)
class Pushable:
    """Equations of motion in the true coordinates, and ``P`` material points spread over the bodies."""

    rest: Vector
    force: Callable[[Vector], Vector]  # generalised force at rest of weight, springs and constant inputs
    acceleration: Callable[[Vector, Vector, Vector], Vector]
    """Of position, velocity and an external generalised force."""
    mass: Callable[[Vector], Matrix]
    places: Callable[[Series], Float64[np.ndarray, "T P n"]]  # of the points in the picture or in space [px]
    share: Float64[np.ndarray, " P"]  # mass that each point represents [kg]

    def jacobian(self, q: Vector) -> Float64[np.ndarray, "P n d"]:
        """Derivative of the points' places [px per unit of each coordinate]."""
        return np.moveaxis(dynamics.differentiate(self.places, q), 0, 2)

    def stiffness(self, q: Vector) -> Matrix:
        """Minus the derivative of ``force``."""
        return dynamics.compute_stiffness(self.force, q)

    def settled(self, point: int, forces: Float64[np.ndarray, "N n"]) -> Float64[np.ndarray, "N d"]:
        """Equilibria under a force on one point that grows from row to row [J/px].

        Newton's method starts each row from the last, and so follows the branch that starts at rest. A row
        without a stable equilibrium is NaN, as after tipping over, and so are those after it.
        """
        equilibria = np.full((len(forces), len(self.rest)), np.nan)

        def total(q: Vector, force: np.ndarray) -> Vector:
            return self.force(q) + force @ self.jacobian(q)[point]

        q = self.rest
        for i, force in enumerate(forces):
            loaded = partial(total, force=force)
            rest = dynamics.find_stable_rest(loaded, q, longest_step=0.2, tolerance=1e-8, iterations=40)
            if rest is None:
                break
            q = equilibria[i] = rest
        return equilibria

    def moved(
        self, point: int, force: Float64[np.ndarray, " n"], *, time_s: Float64[np.ndarray, " T"]
    ) -> Series:
        """States at ``time_s`` after a force on one point is switched on at the first of them, from rest.

        Raises:
            RuntimeError: the solver failed.
        """
        d = len(self.rest)

        def rate(_: float, state: np.ndarray) -> np.ndarray:
            q, v = state[:d], state[d:]
            return np.concatenate([v, self.acceleration(q, v, force @ self.jacobian(q)[point])])

        start, still = self.rest, np.zeros(d)
        return dynamics.integrate_motion(
            rate, start, still, time_s, rtol=1e-6, atol=1e-9, max_step_s=0.05, method="RK45"
        )[0]


def make_pushable(
    driven: SimulationConfig | None,
    released: ReleaseConfig | None,
    *,
    pressure: Float64[np.ndarray, " n_u"],
    points: int,
    in_space: bool = False,
) -> Pushable:
    """The simulated arm or mechanism behind a recording, with ``points`` by ``points`` on each body.

    ``pressure`` [atm] is constant; a released mechanism has none, and alone can be pushed in space.

    Raises:
        ValueError: neither system is given, or it has no rest state.
    """
    if driven is not None:
        return _arm(driven, pressure, points)
    if released is not None:
        return _mechanism(released, points, in_space)
    raise ValueError("the truth of a force is known of simulated systems alone; choose recording=simulated")


def _mechanism(config: ReleaseConfig, points: int, in_space: bool) -> Pushable:
    mechanism, camera, space = make_mechanism(config), make_camera(config), make_space(config)
    masses = [mechanism.body_mass] if isinstance(mechanism, Rocker) else mechanism.masses
    bodies = draw_bodies(config, camera)
    covered = [_list_covered(body.sprite, points) for body in bodies]
    counts = [len(place) for place in covered]
    depths = np.array([-0.5 * body.thickness if body.layers > 1 else 0.0 for body in bodies])
    body_of = np.repeat(np.arange(len(bodies)), counts)
    place_m, depth = np.concatenate(covered), depths[body_of]

    def places(states: Series) -> Float64[np.ndarray, "T P n"]:
        x, y, angle = np.moveaxis(mechanism.poses(states)[:, body_of], 2, 0)
        turned = place_m * np.exp(1j * angle)
        world = np.stack([x + turned.real, y + turned.imag, np.broadcast_to(depth, x.shape)], axis=2)
        flat = world.reshape(-1, 3)
        found = space.inside(flat) if in_space else camera.project(flat) / config.scene.film_scale
        return found.reshape(*x.shape, -1)

    force, share = mechanism.static_force, (np.array(masses) / counts)[body_of]
    rest = find_rest_state(mechanism)
    return Pushable(rest, force, mechanism.acceleration, mechanism.mass, places, share)


def _list_covered(sprite: Sprite, points: int) -> Complex128[np.ndarray, " P"]:
    """Points ``x + i y`` [m] in a body's coordinates, on a grid over its sprite, where it is opaque."""
    covered = sprite.rgba[:, :, 3] > COVERED
    middles = (np.arange(points) + 0.5) / points
    extents = [np.flatnonzero(covered.any(axis)) for axis in (1, 0)]
    sides = [(pixels[0] + middles * (pixels[-1] - pixels[0])).astype(int) for pixels in extents]
    rows, columns = (side.ravel() for side in np.meshgrid(*sides, indexing="ij"))
    on = covered[rows, columns]
    left, top = sprite.origin
    return (columns[on] + 0.5 - left) / sprite.scale + 1j * ((rows[on] + 0.5 - top) / sprite.scale)


def _arm(config: SimulationConfig, pressure: Float64[np.ndarray, " n_u"], points: int) -> Pushable:
    arm = build_arm(config.arm)
    n, middles = arm.d // 2, (np.arange(points) + 0.5) / points
    across = config.arm.half_width * np.array([-0.6, 0.0, 0.6])
    segment, s, offset = (x.ravel() for x in np.meshgrid(np.arange(n), middles, across, indexing="ij"))
    table, per_px = arm.table, config.view_width / config.width

    def places(states: Series) -> Float64[np.ndarray, "T P n"]:
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

    def force(q: Vector) -> Vector:
        return arm.static_force(q, pressure)

    share = (table[:, chain.MASS] + table[:, chain.LINK_MASS])[segment] / (points * len(across))
    return Pushable(arm.equilibrium(pressure), force, acceleration, arm.mass, places, share)


def _arcs(bend: Float64[np.ndarray, " T"], share: float) -> np.ndarray:
    return np.array([chain.arc_points(float(angle), share)[0] for angle in bend])
