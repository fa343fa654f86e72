"""What a URDF file says beside what MuJoCo reads, and where its meshes are."""

from pathlib import Path

import pytest

from lagsplat.io.urdf import Urdf, read_urdf

LINK = '<link name="{0}"><inertial><mass value="1"/></inertial>{1}</link>'
MESH = '<{0}><geometry><mesh filename="{1}"/></geometry></{0}>'


def read(folder: Path, *meshes: str, extra: str = "") -> Urdf:
    (folder / "arm.urdf").write_text(
        f'<robot name="arm">{LINK.format("base", "".join(meshes))}{extra}</robot>'
    )
    return read_urdf(folder / "arm.urdf")


def test_meshes_are_found_where_packages_keep_them(tmp_path: Path) -> None:
    folder = tmp_path / "arm_description" / "urdf"
    folder.mkdir(parents=True)
    for place in ("arm_description/meshes/a.stl", "other/b.stl", "arm_description/urdf/c.obj"):
        (tmp_path / place).parent.mkdir(exist_ok=True)
        (tmp_path / place).write_text("")
    names = {
        "package://arm_description/meshes/a.stl": "arm_description/meshes/a.stl",
        "package://renamed/meshes/a.stl": "arm_description/meshes/a.stl",
        "model://other/b.stl": "other/b.stl",
        "c.obj": "arm_description/urdf/c.obj",
        "../meshes/a.stl": "arm_description/meshes/a.stl",
        f"file://{tmp_path}/other/b.stl": "other/b.stl",
        "package://arm_description/lost/c.obj": "arm_description/urdf/c.obj",
    }
    for name, place in names.items():
        found = read(folder, MESH.format("collision", name))
        assert f'filename="{tmp_path / place}"' in found.text, name
        assert found.lost_meshes == ()
    for name in ("gone.stl", "http://host/a.stl", "package://other/gone.stl"):
        found = read(folder, MESH.format("collision", name), MESH.format("visual", name))
        assert found.lost_meshes == (f"{name} of link base, which is not there",)
        assert "mesh" not in found.text


def test_settings_of_mujoco_in_the_file_stay(tmp_path: Path) -> None:
    own = '<mujoco><compiler balanceinertia="true" meshdir="meshes"/></mujoco>'
    text = read(tmp_path, extra=own).text
    assert 'balanceinertia="true"' in text
    assert 'strippath="false"' in text
    assert "meshdir" not in text
    assert 'strippath="false"' in read(tmp_path).text


def test_transmissions_are_read_in_both_spellings(tmp_path: Path) -> None:
    extra = """<transmission name="old"><type> transmission_interface/SimpleTransmission </type>
    <joint name="j"><hardwareInterface>hardware_interface/VelocityJointInterface</hardwareInterface></joint>
    <actuator name="a"><mechanicalReduction>-4</mechanicalReduction></actuator></transmission>
    <transmission name="new"><plugin>transmission_interface/FourBarLinkageTransmission</plugin>
    <joint name="k"/><joint name="l"/></transmission>"""
    old, new = read(tmp_path, extra=extra).transmissions
    assert (old.is_simple, old.reduction, old.interface) == (True, -4.0, "velocityjointinterface")
    assert (new.is_simple, new.joints) == (False, ("k", "l"))


def transmission(reduction: str) -> str:
    inner = f"<mechanicalReduction>{reduction}</mechanicalReduction>"
    return f'<transmission name="t"><joint name="j"/><actuator name="a">{inner}</actuator></transmission>'


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("<robot", "no XML .*; repair or export it again"),
        ("<sdf/>", "its root is <sdf> and not <robot>, so it is no URDF"),
        (
            '<robot xmlns:xacro="http://www.ros.org/wiki/xacro"><xacro:arm/></robot>',
            "expand them first: xacro arm.urdf > robot.urdf",
        ),
        ('<robot><link name="a"/><link name="b"/></robot>', r"without a parent are \['a', 'b'\]"),
        ("<robot/>", r"without a parent are \[\]; a URDF has exactly one"),
        (
            '<robot><link name="a"/><joint name="j" type="ball"/></robot>',
            "joint 'j' is of type 'ball'; those of a URDF are .* give an MJCF",
        ),
        (f'<robot><link name="a"/>{transmission("2:1")}</robot>', "reduction '2:1', which is no number"),
        (f'<robot><link name="a"/>{transmission("0")}</robot>', "'t' has a reduction of 0; correct it"),
    ],
)
def test_what_is_no_robot_is_refused(tmp_path: Path, text: str, message: str) -> None:
    (tmp_path / "arm.urdf").write_text(text)
    with pytest.raises(ValueError, match=message):
        read_urdf(tmp_path / "arm.urdf")


def test_a_urdf_that_is_not_there_is_named(tmp_path: Path) -> None:
    with pytest.raises(FileNotFoundError, match=r"arm\.urdf: no such file; check the path"):
        read_urdf(tmp_path / "arm.urdf")


def test_joints_masses_and_elements_of_other_programs_are_told(tmp_path: Path) -> None:
    extra = """<link name="hand"><collision><geometry><box size="1 1 1"/></geometry></collision></link>
    <link name="tip"/>
    <joint name="j" type="revolute"><parent link="base"/><child link="hand"/><limit velocity="2"/></joint>
    <joint name="k" type="fixed"><parent link="hand"/><child link="tip"/><mimic joint="j"/></joint>
    <gazebo/>"""
    found = read(tmp_path, extra=extra)
    assert (found.root, found.root_has_mass, found.massless, found.ignored) == (
        "base", True, ("hand",), ("gazebo",)
    )  # fmt: skip
    assert [(j.name, j.type, j.mimics, j.velocity_limit) for j in found.joints] == [
        ("j", "revolute", None, True),
        ("k", "fixed", "j", False),
    ]
