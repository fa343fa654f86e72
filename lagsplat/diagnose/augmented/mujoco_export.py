"""Effects of a diagnosis written into a MuJoCo model file; that of a URDF becomes an MJCF.

Each effect says itself which element of MuJoCo is its counterpart (`Effect.mujoco`) and changes it through a
`MujocoElement`. A generalised force of a diagnosis is an acceleration times the reference inertia of its
joint, the diagonal of the mass matrix at rest; in the file it is a force again.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
from numpy.polynomial import Polynomial

from lagsplat.diagnose.augmented.model import AugmentedSimulator
from lagsplat.diagnose.effects.base import ForceEffect, InputEffect, PlacedEffect
from lagsplat.diagnose.simulators.mujoco_model import make_mujoco_fields
from lagsplat.io.files.atomic import write_text
from lagsplat.io.mujoco.model import URDF, MujocoSelection, load_mujoco, load_spec
from lagsplat.io.mujoco.package import get_angle_unit, require_mujoco

WEAK_SPRING = 1e-6  # stiffness, relative to its force, of a spring that stands for a constant force


@dataclass(frozen=True)
class MujocoElement:
    """Where an effect acts in a MuJoCo specification, and what can be changed there.

    Methods that change the specification return what they changed, for people, or nothing if they cannot.
    """

    spec: Any  # the `mujoco.MjSpec`
    selection: MujocoSelection
    """The compiled model, with the joints and actuators that are coordinates and inputs."""
    joint: Any  # none where the effect acts on all of several joints
    actuator: Any
    inertia: float  # reference inertia: diagonal of the mass matrix at rest
    compliance: float  # diagonal of the inverse mass matrix at rest
    rest: float  # coordinate at rest
    placed: PlacedEffect

    @property
    def mujoco(self) -> Any:
        """The module, for its enumerations."""
        return require_mujoco()

    @property
    def angle_unit(self) -> float:
        """Unit of the joint's positions in the specification."""
        return get_angle_unit(self.spec, self.joint)

    def add_spring(self, added: Polynomial) -> tuple[str, ...]:
        """Add to the joint's spring; MuJoCo counts powers from where the spring is slack, a root.

        ``added`` is the force with the sign reversed, over the coordinate.
        """
        joint = self.joint
        shifted = Polynomial([-float(joint.springref) * self.angle_unit, 1.0])
        present = Polynomial([0.0, *np.asarray(joint.stiffness, dtype=np.float64)])(shifted)
        total = (present + added).trim()
        size = float(np.abs(total.coef).max())
        if total.degree() < 1:
            total = total + Polynomial([0.0, WEAK_SPRING * size])
        roots = total.roots()
        real = roots.real[np.abs(roots.imag) < 1e-9 * (1.0 + np.abs(roots))]
        if not len(real):
            return ()
        slack = float(real[np.argmin(np.abs(real - float(joint.springref) * self.angle_unit))])
        about = total(Polynomial([slack, 1.0]))
        k = np.zeros(3)
        k[: about.degree()] = about.coef[1:]
        joint.stiffness, joint.springref = k, slack / self.angle_unit
        return (f"joint {joint.name}: stiffness {self.format_row(k)} about springref {slack:.6g}",)

    def scale_springs(self, joints: Sequence[Any], ratio: float) -> tuple[str, ...]:
        """Multiply the springs of some joints."""
        for joint in joints:
            joint.stiffness = ratio * np.asarray(joint.stiffness, dtype=np.float64)
        springs = [joint for joint in joints if np.any(joint.stiffness)]
        return tuple(f"joint {each.name}: stiffness {self.format_row(each.stiffness)}" for each in springs)

    def raise_damping(self, power: int, acceleration: float) -> tuple[str, ...]:
        """Add to the joint's damping, linear (``power`` 0) or quadratic (1) in the speed."""
        joint = self.joint
        if joint is None:
            return ()
        row = np.asarray(joint.damping, dtype=np.float64).copy()
        row[power] += acceleration * self.inertia
        if row[power] < 0.0:
            return ()
        joint.damping = row
        return (f"joint {joint.name}: damping {self.format_row(row)}",)

    def scale_masses(self, ratio: float) -> None:
        """Multiply mass and inertia of everything, whichever way the file gives them."""
        for body in self.spec.bodies:
            if body.explicitinertial:
                body.mass = ratio * body.mass
                body.inertia = ratio * np.asarray(body.inertia, dtype=np.float64)
                body.fullinertia = ratio * np.asarray(body.fullinertia, dtype=np.float64)
        for geom in self.spec.geoms:
            if np.isnan(geom.mass):
                geom.density = ratio * geom.density
            else:
                geom.mass = ratio * geom.mass

    @staticmethod
    def format_row(values: Any) -> str:
        """Numbers as in a MuJoCo file."""
        return " ".join(f"{value:.6g}" for value in np.asarray(values, dtype=np.float64))


def patch_augmented(
    path: Path,
    out: Path,
    simulator: AugmentedSimulator,
    *,
    joints: Sequence[str] | None = None,
    actuators: Sequence[str] | None = None,
    parameters: str | None = None,
    inertia: float | None = None,
) -> tuple[str, ...]:
    """Write a MuJoCo model with the effects of an augmented simulator, and return the changes, for people.

    Where MuJoCo has no counterpart of one of them, it writes and returns nothing. ``joints`` and
    ``actuators`` are the coordinates and inputs, by default all, ``parameters`` a file of `mujoco.sysid`
    whose values the simulator has in place of the file's. ``inertia`` is what a simulator of a single
    coordinate counts forces in, where that is not the file's inertia at rest.

    Raises:
        FileNotFoundError, ValueError: as `load_mujoco`, or the changed model is refused by MuJoCo.
    """
    directions = [placed.direction for placed in simulator.effects if placed.direction is not None]
    if any(np.count_nonzero(direction.covector) > 1 for direction in directions):
        return ()  # between two joints
    selection = load_mujoco(path, joints=joints, actuators=actuators, parameters=parameters)
    mass = make_mujoco_fields(selection).mass(simulator.model.rest[None])[0]
    mass = mass if inertia is None else np.array([[inertia]])
    spec = load_spec(path, parameters)
    changed: list[str] = []
    for n, placed in enumerate(simulator.effects):
        along = None if placed.direction is None else int(np.argmax(np.abs(placed.direction.covector)))
        at = along or 0
        element = MujocoElement(
            spec=spec,
            selection=selection,
            joint=_find_element(spec.joints, selection.joints, along, path),
            actuator=_find_element(spec.actuators, selection.actuators, placed.channel, path),
            inertia=float(mass[at, at]),
            compliance=float(np.linalg.inv(mass)[at, at]),
            rest=float(simulator.model.rest[at]),
            placed=placed,
        )
        effect = placed.effect
        several_joints = element.joint is None and isinstance(effect, ForceEffect) and effect.whole is None
        several_actuators = element.actuator is None and isinstance(effect, InputEffect)
        if isinstance(effect.mujoco, str) or several_joints or several_actuators:
            return ()
        written = effect.mujoco(element, simulator.parameters(n))
        if not written:
            return ()
        changed += written
    if spec.meshes or spec.textures or spec.hfields or spec.skins:
        spec.meshdir = str((path.parent / (spec.meshdir or "")).resolve())
        spec.texturedir = str((path.parent / (spec.texturedir or "")).resolve())
    try:
        spec.compile()
    except ValueError as error:
        changes = "; ".join(changed)
        raise ValueError(f"{path}: MuJoCo refuses the changed model ({error}); {changes}") from error
    write_text(out, spec.to_xml())
    if path.suffix.lower() == URDF:
        changed.append(f"{out.name} is an MJCF, as a URDF has no place for all that MuJoCo simulates")
    return tuple(changed)


def _find_element(elements: Sequence[Any], names: Sequence[str], index: int | None, path: Path) -> Any:
    """The element of the coordinate or input of this index, or the only one; None for all of several."""
    if index is None and len(names) != 1:
        return None
    name = names[index or 0]
    named = [element for element in elements if element.name == name]
    if not named:
        raise ValueError(f"{path}: {name!r} has no name in the file; give it one, so that it can be changed")
    return named[0]
