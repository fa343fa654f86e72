"""One arm with own numbers, as URDF and as MJCF: of two links, and of six."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation


@dataclass(frozen=True)
class Link:
    """A link and the joint at its beginning; angles are URDF's roll, pitch and yaw [rad]."""

    xyz: tuple[float, float, float]
    rpy: tuple[float, float, float]
    axis: tuple[float, float, float]
    mass: float
    com: tuple[float, float, float]
    inertia: tuple[
        float, float, float, float, float, float
    ]  # xx, yy, zz, xy, xz, yz about the centre of mass
    turned: tuple[float, float, float] = (0.0, 0.0, 0.0)  # axes of the inertia, as roll, pitch and yaw
    damping: float = 0.0
    friction: float = 0.0
    slides: bool = False


TWO = (
    Link(
        (0, 0, 0.3),
        (0, 0, 0),
        (0, 1, 0),
        1.3,
        (0.01, 0, -0.21),
        (0.02, 0.018, 0.004, 0, 0.001, 0),
        damping=0.12,
    ),
    Link(
        (0, 0.02, -0.4),
        (0, 0, 0.1),
        (0, 1, 0),
        0.7,
        (0, 0, -0.16),
        (0.006, 0.0055, 0.001, 0.0002, 0, 0),
        damping=0.05,
    ),
)
SIX = (
    Link(
        (0, 0, 0.2),
        (0, 0, 0.3),
        (0, 0, 1),
        3.1,
        (0.01, 0.02, 0.05),
        (0.03, 0.028, 0.02, 0.001, 0, 0.002),
        damping=0.9,
    ),
    Link(
        (0.05, 0, 0.15),
        (1.2, 0.1, 0),
        (0, 0.6, 0.8),
        2.4,
        (0.2, 0, 0.01),
        (0.01, 0.06, 0.058, 0, 0.003, 0),
        turned=(0.2, -0.4, 0.7),
        damping=0.7,
        friction=0.3,
    ),
    Link(
        (0.42, 0, 0),
        (0, -0.7, 0.2),
        (0, 1, 0),
        1.7,
        (0.12, 0.01, 0),
        (0.004, 0.02, 0.021, 0, 0, 0.001),
        friction=0.2,
    ),
    Link(
        (0.3, 0.03, 0),
        (0.4, 0, 1.1),
        (1, 0, 0),
        0.9,
        (0.03, 0, 0.04),
        (0.002, 0.0022, 0.0018, 0, 0, 0),
        turned=(0, 0.5, 0),
        damping=0.1,
    ),
    Link(
        (0, 0, 0.11),
        (0, 0, 0),
        (0, 0, 1),
        0.5,
        (0, 0.02, 0),
        (0.0009, 0.0008, 0.0007, 0, 0, 0),
        slides=True,
        damping=4.0,
    ),
    Link(
        (0.02, 0.02, 0.08),
        (-0.3, 0.6, 0.2),
        (0, 1, 0),
        0.25,
        (0.01, 0, 0.03),
        (0.0004, 0.0004, 0.0002, 0, 0, 0),
    ),
)


def with_fault(links: Sequence[Link], i: int, **changes: float) -> tuple[Link, ...]:
    return tuple(replace(link, **changes) if n == i else link for n, link in enumerate(links))


def words(values: Sequence[float]) -> str:
    return " ".join(repr(float(value)) for value in values)


def write_urdf(
    path: Path, links: Sequence[Link], *, extra: str = "", reductions: Sequence[float] = ()
) -> Path:
    """Write links L0, ... with joints j0, ..., a motor m0, ... for each of ``reductions``, and ``extra``."""
    body = '<link name="base"/>'
    for i, link in enumerate(links):
        xx, yy, zz, xy, xz, yz = link.inertia
        kind = "prismatic" if link.slides else "revolute"
        parent = f"L{i - 1}" if i else "base"
        body += f"""<link name="L{i}"><inertial><mass value="{link.mass!r}"/>
        <origin xyz="{words(link.com)}" rpy="{words(link.turned)}"/>
        <inertia ixx="{xx}" iyy="{yy}" izz="{zz}" ixy="{xy}" ixz="{xz}" iyz="{yz}"/></inertial></link>
        <joint name="j{i}" type="{kind}"><parent link="{parent}"/><child link="L{i}"/>
        <origin xyz="{words(link.xyz)}" rpy="{words(link.rpy)}"/><axis xyz="{words(link.axis)}"/>
        <limit lower="-3" upper="3" effort="200" velocity="9"/>
        <dynamics damping="{link.damping!r}" friction="{link.friction!r}"/></joint>"""
    for i, reduction in enumerate(reductions):
        body += f"""<transmission name="t{i}"><type>transmission_interface/SimpleTransmission</type>
        <joint name="j{i}">
        <hardwareInterface>hardware_interface/EffortJointInterface</hardwareInterface></joint>
        <actuator name="m{i}"><mechanicalReduction>{reduction!r}</mechanicalReduction></actuator>
        </transmission>"""
    path.write_text(f'<?xml version="1.0"?><robot name="arm">{body}{extra}</robot>')
    return path


def write_mjcf(path: Path, links: Sequence[Link], *, reductions: Sequence[float] = ()) -> Path:
    """The same arm as MJCF, its rotations and inertias turned by SciPy."""
    body, ends = "", ""
    for i, link in enumerate(links):
        x, y, z, w = Rotation.from_euler("xyz", link.rpy).as_quat()
        xx, yy, zz, xy, xz, yz = link.inertia
        turn = Rotation.from_euler("xyz", link.turned).as_matrix()
        tensor = turn @ np.array([[xx, xy, xz], [xy, yy, yz], [xz, yz, zz]]) @ turn.T
        full = [tensor[0, 0], tensor[1, 1], tensor[2, 2], tensor[0, 1], tensor[0, 2], tensor[1, 2]]
        body += f"""<body name="L{i}" pos="{words(link.xyz)}" quat="{words((w, x, y, z))}">
        <inertial pos="{words(link.com)}" mass="{link.mass!r}" fullinertia="{words(full)}"/>
        <joint name="j{i}" type="{"slide" if link.slides else "hinge"}" axis="{words(link.axis)}"
        damping="{link.damping!r}" frictionloss="{link.friction!r}"/>"""
        ends += "</body>"
    motors = "".join(
        f'<motor name="m{i}" joint="j{i}" gear="{gear!r}"/>' for i, gear in enumerate(reductions)
    )
    path.write_text(
        '<mujoco><option timestep="0.0005" integrator="implicitfast"><flag contact="disable"/></option>'
        f"<worldbody>{body}{ends}</worldbody><actuator>{motors}</actuator></mujoco>"
    )
    return path
