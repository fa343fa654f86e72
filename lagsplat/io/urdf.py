"""Read the robot in a URDF file: what MuJoCo's own reader of the format does not take along, and its meshes.

Meshes are looked for beside the file and in the folders above it, where a package of ROS keeps them, and get
absolute paths. Those that are not there, or of a kind that MuJoCo does not read, are taken out.

Source: the elements of URDF and of `ros2_control` as ROS documents them (wiki.ros.org/urdf/XML).
"""

import xml.etree.ElementTree as ET
from dataclasses import dataclass
from pathlib import Path, PurePosixPath

JOINT_TYPES = ("revolute", "continuous", "prismatic", "fixed", "floating", "planar")
MESHES = (".stl", ".obj", ".msh")  # suffixes that MuJoCo reads
SIMPLE = "simpletransmission"
IGNORED = ("gazebo", "safety_controller", "calibration")  # elements that no simulator but their own reads


@dataclass(frozen=True)
class UrdfJoint:
    """A joint of the file; ``mimics`` is the joint that it follows, if any."""

    name: str
    type: str
    mimics: str | None = None
    velocity_limit: bool = False


@dataclass(frozen=True)
class UrdfTransmission:
    """Motors at joints; that of a simple transmission turns ``reduction`` times as fast as its joint.

    ``interface`` is the kind of command, in lower case, as far as the file tells.
    """

    name: str
    type: str
    joints: tuple[str, ...]
    actuators: tuple[str, ...]
    reduction: float
    interface: str

    @property
    def is_simple(self) -> bool:
        """Whether it is one motor at one joint."""
        kind = self.type.replace("_", "").lower()
        return len(self.joints) == 1 and len(self.actuators) <= 1 and (not kind or kind.endswith(SIMPLE))


@dataclass(frozen=True)
class Urdf:
    """A robot: the text for MuJoCo, and what it says beside that."""

    text: str
    root: str  # the link without a parent
    root_has_mass: bool
    joints: tuple[UrdfJoint, ...]
    transmissions: tuple[UrdfTransmission, ...]
    effort_joints: tuple[str, ...]  # joints with a command interface of effort in `ros2_control`
    massless: tuple[str, ...]  # links without an inertia that have a geometry for contacts
    lost_meshes: tuple[str, ...]  # meshes for contacts that were taken out, and why: "FILE of link LINK, ..."
    ignored: tuple[str, ...]  # elements that only other programs read


def read_urdf(path: Path) -> Urdf:
    """Read the URDF file at ``path``.

    Raises:
        FileNotFoundError: there is no file.
        ValueError: no XML, no robot, a macro that is not expanded, a joint of an unknown type, or a number
            that is none.
    """
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; check the path")
    try:
        robot = ET.fromstring(path.read_bytes())
    except ET.ParseError as error:
        raise ValueError(f"{path}: no XML ({error}); repair or export it again") from error
    if robot.tag != "robot":
        raise ValueError(
            f"{path}: its root is <{robot.tag}> and not <robot>, so it is no URDF; check the file"
        )
    if any("xacro" in each.tag for each in robot.iter()):
        raise ValueError(f"{path}: holds macros of xacro; expand them first: xacro {path.name} > robot.urdf")
    joints = tuple(_read_joint(path, each) for each in robot.findall("joint"))
    children = {_attribute(each.find("child"), "link") for each in robot.findall("joint")}
    links = robot.findall("link")
    roots = [each for each in links if each.get("name", "") not in children]
    if len(roots) != 1:
        names = [each.get("name", "") for each in roots]
        raise ValueError(f"{path}: links without a parent are {names}; a URDF has exactly one")
    lost = tuple(mesh for each in links for mesh in _settle_meshes(path, each))
    _keep_paths(robot)
    return Urdf(
        text=ET.tostring(robot, encoding="unicode"),
        root=roots[0].get("name", ""),
        root_has_mass=roots[0].find("inertial") is not None,
        joints=joints,
        transmissions=tuple(_read_transmission(path, each) for each in robot.iter("transmission")),
        effort_joints=tuple(
            each.get("name", "")
            for control in robot.findall("ros2_control")
            for each in control.findall("joint")
            if any(command.get("name") == "effort" for command in each.findall("command_interface"))
        ),
        massless=tuple(
            each.get("name", "")
            for each in links
            if each.find("inertial") is None and each.find("collision") is not None
        ),
        lost_meshes=lost,
        ignored=tuple(name for name in IGNORED if next(robot.iter(name), None) is not None),
    )


def _attribute(element: ET.Element | None, name: str) -> str:
    return "" if element is None else element.get(name, "")


def _read_joint(path: Path, element: ET.Element) -> UrdfJoint:
    name, kind = element.get("name", ""), element.get("type", "")
    if kind not in JOINT_TYPES:
        raise ValueError(
            f"{path}: joint {name!r} is of type {kind!r}; those of a URDF are {', '.join(JOINT_TYPES)}. "
            "Replace it by one of these, or give an MJCF"
        )
    mimic = element.find("mimic")
    return UrdfJoint(
        name,
        kind,
        mimics=None if mimic is None else mimic.get("joint", ""),
        velocity_limit=bool(_attribute(element.find("limit"), "velocity")),
    )


def _read_transmission(path: Path, element: ET.Element) -> UrdfTransmission:
    name = element.get("name", "")
    kind = element.findtext("type") or element.findtext("plugin") or element.get("type") or ""
    parts = [*element.findall("joint"), *element.findall("actuator")]
    reduction = 1.0
    for each in (element, *parts):
        for tag in ("mechanicalReduction", "mechanical_reduction"):
            text = each.findtext(tag)
            if text is None:
                continue
            try:
                reduction *= float(text)
            except ValueError:
                place = f"transmission {name!r} has the reduction {text!r}"
                raise ValueError(f"{path}: {place}, which is no number; correct it") from None
    if not reduction:
        raise ValueError(f"{path}: transmission {name!r} has a reduction of 0; correct it")
    interfaces = [each.findtext("hardwareInterface") or "" for each in parts]
    return UrdfTransmission(
        name,
        kind.strip().rpartition("/")[2],
        joints=tuple(each.get("name", "") for each in element.findall("joint")),
        actuators=tuple(each.get("name", "") for each in element.findall("actuator")),
        reduction=reduction,
        interface=next((each.strip().rpartition("/")[2].lower() for each in interfaces if each), ""),
    )


def _settle_meshes(path: Path, link: ET.Element) -> list[str]:
    """Give the meshes of a link absolute paths; take out, and list, those that MuJoCo cannot read."""
    lost = []
    for use in (*link.findall("visual"), *link.findall("collision")):
        mesh = use.find("geometry/mesh")
        if mesh is None:
            continue
        name = mesh.get("filename", "")
        found = _find_mesh(path, name)
        if found is not None and found.suffix.lower() in MESHES:
            mesh.set("filename", str(found))
            continue
        link.remove(use)
        if use.tag == "collision":  # what is seen has no part in the dynamics
            why = (
                "is not there"
                if found is None
                else f"is of a kind MuJoCo does not read ({', '.join(MESHES)})"
            )
            lost.append(f"{name} of link {link.get('name', '')}, which {why}")
    return lost


def _find_mesh(path: Path, name: str) -> Path | None:
    """The file of a mesh: relative to the URDF, or below the folder of its package."""
    scheme, separator, rest = name.partition("://")
    if not separator:
        scheme, rest = "", name
    folder = path.resolve().parent
    if scheme in ("", "file"):
        places = [folder / rest]
    elif scheme in ("package", "model"):
        package, _, inside = rest.partition("/")
        above = (folder, *folder.parents)
        places = [place / inside for place in above if place.name == package]
        places += [place / package / inside for place in above]
        places += [place / inside for place in above[:2]]  # the package's folder may have another name
    else:
        return None
    places.append(folder / PurePosixPath(rest).name)
    return next((place.resolve() for place in places if place.is_file()), None)


def _keep_paths(robot: ET.Element) -> None:
    """Tell MuJoCo to keep the folders of meshes, which it strips by default; its other settings stay."""
    extension = robot.find("mujoco")
    if extension is None:
        extension = ET.SubElement(robot, "mujoco")
    compiler = extension.find("compiler")
    if compiler is None:
        compiler = ET.SubElement(extension, "compiler")
    compiler.set("strippath", "false")
    compiler.attrib.pop("meshdir", None)
