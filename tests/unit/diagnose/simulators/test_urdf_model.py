"""URDF files as sims: their dynamics against those of the same arm in MJCF, and what is told to be lost."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from lagsplat.diagnose.core.result import Finding
from lagsplat.diagnose.simulators.mujoco_model import check_urdf, make_mujoco_fields
from lagsplat.io.mujoco.model import load_mujoco, load_spec
from tests.unit.io.mujoco.urdf_files import SIX, TWO, Link, write_mjcf, write_urdf

mujoco = pytest.importorskip("mujoco")

XACRO = 'xmlns:xacro="http://www.ros.org/wiki/xacro"'
WRONG = """<transmission name="t"><joint name="j0"/><actuator name="a">
<mechanicalReduction>two</mechanicalReduction></actuator></transmission>"""


def told(path: Path) -> dict[str, Finding]:
    """The findings, each by the first words of what it says."""
    return {" ".join(finding.what.split()[:3]): finding for finding in check_urdf(path)}


def text_of(path: Path) -> str:
    return " | ".join(finding.text for finding in check_urdf(path))


def with_part(path: Path, links: Sequence[Link], extra: str) -> Path:
    return write_urdf(path, links, extra=extra)


@pytest.mark.parametrize("links", [TWO, SIX], ids=["two", "six"])
def test_the_dynamics_are_those_of_the_same_arm_in_mjcf(tmp_path: Path, links: tuple[Link, ...]) -> None:
    gears = [1.0 + 0.5 * i for i in range(len(links))]
    ours = load_mujoco(write_urdf(tmp_path / "arm.urdf", links, reductions=gears))
    theirs = mujoco.MjModel.from_xml_path(str(write_mjcf(tmp_path / "arm.xml", links, reductions=gears)))
    assert ours.joints == tuple(f"j{i}" for i in range(len(links)))
    assert ours.actuators == tuple(f"m{i}" for i in range(len(links)))
    data, fields = mujoco.MjData(theirs), make_mujoco_fields(ours)
    rng, mass = np.random.default_rng(3), np.zeros((theirs.nv, theirs.nv))
    for _ in range(20):
        q, v, u = (size * rng.uniform(-1.0, 1.0, theirs.nv) for size in (1.5, 3.0, 2.0))
        data.qpos[:], data.qvel[:], data.qacc[:] = q, v, rng.uniform(-5.0, 5.0, theirs.nv)
        mujoco.mj_inverse(theirs, data)
        wanted = data.qfrc_inverse.copy()
        acceleration, bias = data.qacc.copy(), data.qfrc_bias.copy()
        ours.data.qpos[:], ours.data.qvel[:], ours.data.qacc[:] = q, v, acceleration
        mujoco.mj_inverse(ours.model, ours.data)
        np.testing.assert_allclose(ours.data.qfrc_inverse, wanted, rtol=1e-9, atol=1e-9)
        mujoco.mj_fullM(theirs, data, mass)
        np.testing.assert_allclose(fields.mass(q[None])[0], mass, rtol=1e-9, atol=1e-12)
        data.ctrl[:] = u
        mujoco.mj_forward(theirs, data)
        dry = theirs.dof_frictionloss * np.sign(v)
        smooth = np.linalg.solve(mass, gears * u + data.qfrc_passive - bias - dry)
        force = (
            fields.input_map(q[None])[0].T @ u
            - fields.potential_gradient(q[None])[0]
            - fields.dissipation(q[None], v[None])[0]
        )
        still = np.zeros(theirs.nv)
        data.qvel[:] = 0.0
        mujoco.mj_forward(theirs, data)
        gyroscopic = bias - data.qfrc_bias  # which the simulator derives from the mass matrix
        found = np.linalg.solve(fields.mass(q[None])[0], force - gyroscopic)
        np.testing.assert_allclose(found, smooth, rtol=1e-9, atol=1e-9)
        assert not np.allclose(smooth, still)


def test_a_mimic_joint_moves_with_the_one_it_follows(tmp_path: Path) -> None:
    free = load_mujoco(write_urdf(tmp_path / "free.urdf", SIX))
    text = (tmp_path / "free.urdf").read_text()
    mark = '<joint name="j2" type="revolute">'
    (tmp_path / "tied.urdf").write_text(
        text.replace(mark, f'{mark}<mimic joint="j1" multiplier="-0.5" offset="0.2"/>')
    )
    tied = load_mujoco(tmp_path / "tied.urdf")
    assert tied.joints == ("j0", "j1", "j3", "j4", "j5")
    rates = np.insert(np.eye(5), 2, [0.0, -0.5, 0.0, 0.0, 0.0], axis=0)
    np.testing.assert_array_equal(tied.jacobian, rates)
    q = np.array([0.3, -0.8, 0.5, 0.1, 0.9])
    v = np.array([1.0, -2.0, 0.7, 0.1, 0.4])
    whole = (rates @ q + np.array([0, 0, 0.2, 0, 0, 0]))[None]
    ours, theirs = make_mujoco_fields(tied), make_mujoco_fields(free)
    reduced = rates.T @ theirs.mass(whole)[0] @ rates
    np.testing.assert_allclose(ours.mass(q[None])[0], reduced, rtol=1e-12)
    gradient = rates.T @ theirs.potential_gradient(whole)[0]
    np.testing.assert_allclose(ours.potential_gradient(q[None])[0], gradient, atol=1e-12)
    lost = rates.T @ theirs.dissipation(whole, (rates @ v)[None])[0]
    np.testing.assert_allclose(ours.dissipation(q[None], v[None])[0], lost, atol=1e-12)
    assert "joints j2 follow others (<mimic>) exactly" in text_of(tmp_path / "tied.urdf")
    assert load_mujoco(tmp_path / "tied.urdf", joints=["j1", "j2"]).followers == ()
    fixed = load_mujoco(tmp_path / "tied.urdf", joints=["j0"])  # j2 rests where the resting j1 puts it
    (follower,) = fixed.followers
    assert (follower.offset, follower.ratios.tolist()) == (0.2, [0.0])
    wrong = text.replace(mark, f'{mark}<mimic joint="j9"/>')
    (tmp_path / "wrong.urdf").write_text(wrong)
    assert "<mimic> of j2 is lost" in text_of(tmp_path / "wrong.urdf")
    assert "j2" in load_mujoco(tmp_path / "wrong.urdf").joints


def test_transmissions_become_motors_or_are_told(tmp_path: Path) -> None:
    path = write_urdf(tmp_path / "arm.urdf", TWO, reductions=[50.0])
    chosen = load_mujoco(path)
    assert chosen.actuators == ("m0",)
    assert chosen.model.actuator_gear[:, 0].tolist() == [50.0]
    assert chosen.model.jnt_actfrcrange[0].tolist() == [-200.0, 200.0]
    assert "mechanicalReduction: m0 (50 at j0)" in text_of(path)
    assert "no <transmission> drives joints j1" in text_of(path)
    both = """<transmission name="d"><type>transmission_interface/DifferentialTransmission</type>
    <joint name="j0"/><joint name="j1"/><actuator name="a"/><actuator name="b"/></transmission>
    <transmission name="p"><type>transmission_interface/SimpleTransmission</type>
    <joint name="j1"><hardwareInterface>PositionJointInterface</hardwareInterface></joint></transmission>
    <transmission name="x"><joint name="j7"/><actuator name="c"/></transmission>"""
    path = write_urdf(tmp_path / "both.urdf", TWO, extra=both)
    assert load_mujoco(path).actuators == ("p",)
    text = text_of(path)
    assert "transmission d is a DifferentialTransmission, and has no motor" in text
    assert "transmission p takes positionjointinterface commands, and the sim's motor a torque" in text
    assert "transmission x names j7, no moving joint" in text
    modern = """<ros2_control name="c" type="system">
    <joint name="j0"><command_interface name="effort"/></joint>
    <joint name="j1"><command_interface name="position"/></joint>
    <transmission name="t"><plugin>transmission_interface/SimpleTransmission</plugin>
    <actuator name="a1" role="actuator1"/><joint name="j1" role="joint1">
    <mechanical_reduction>3.5</mechanical_reduction></joint></transmission></ros2_control>"""
    chosen = load_mujoco(write_urdf(tmp_path / "modern.urdf", TWO, extra=modern))
    assert chosen.actuators == ("a1", "j0")
    assert chosen.model.actuator_gear[:, 0].tolist() == [3.5, 1.0]
    twice = '<transmission name="t{0}"><joint name="j{0}"/><actuator name="m"/></transmission>'
    path = write_urdf(tmp_path / "twice.urdf", TWO, extra=twice.format(0) + twice.format(1))
    assert load_mujoco(path).actuators == ("m", "t1")


def test_meshes_are_found_or_told_with_their_file(tmp_path: Path) -> None:
    package = tmp_path / "arm_description"
    (package / "urdf").mkdir(parents=True)
    (package / "meshes").mkdir()
    corners = np.array([[0, 0, 0], [0.1, 0, 0], [0, 0.1, 0], [0, 0, 0.1]], np.float32)
    (package / "meshes" / "link.obj").write_text(
        "".join(f"v {x:g} {y:g} {z:g}\n" for x, y, z in corners) + "f 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n"
    )
    (package / "meshes" / "link.dae").write_text("<COLLADA/>")
    use = '<{0}><geometry><mesh filename="{1}"/></geometry></{0}>'
    extra = (
        '<link name="tool">'
        + use.format("collision", "package://arm_description/meshes/link.obj")
        + use.format("collision", "package://arm_description/meshes/link.dae")
        + use.format("collision", "file://gone.stl")
        + use.format("visual", "package://none/seen.stl")
        + '<inertial><mass value="0.1"/><inertia ixx="1e-4" iyy="1e-4" izz="1e-4" ixy="0" ixz="0" iyz="0"/>'
        '</inertial></link><joint name="f" type="fixed"><parent link="L1"/><child link="tool"/></joint>'
    )
    path = write_urdf(package / "urdf" / "arm.urdf", TWO, extra=extra)
    chosen = load_mujoco(path)
    assert chosen.model.nmesh == 1
    text = text_of(path)
    assert "link.dae of link tool, which is of a kind MuJoCo does not read (.stl, .obj, .msh)" in text
    assert "file://gone.stl of link tool, which is not there" in text
    assert "seen.stl" not in text
    (package / "meshes" / "flat.obj").write_text("v 0 0 0\n")
    path.write_text(path.read_text().replace("link.obj", "flat.obj"))
    with pytest.raises(ValueError, match="replace the mesh by a whole one"):
        load_mujoco(path)


def test_bases_types_and_other_elements(tmp_path: Path) -> None:
    path = write_urdf(tmp_path / "arm.urdf", TWO, extra="<gazebo/>")
    assert list(told(path)) == ["<gazebo>, limits of", "no <transmission> drives"]
    text = path.read_text()

    def changed(old: str, new: str) -> Path:
        assert old in text
        (tmp_path / "changed.urdf").write_text(text.replace(old, new))
        return tmp_path / "changed.urdf"

    mass = '<inertial><mass value="5"/><inertia ixx="1" iyy="1" izz="1" ixy="0" ixz="0" iyz="0"/></inertial>'
    heavy = changed('<link name="base"/>', f'<link name="base">{mass}</link>')
    assert "the link base, which has a mass, is fixed to the world" in text_of(heavy)
    floating = changed(
        '<link name="base"/>',
        f'<link name="world"/><link name="base">{mass}</link><joint name="w" type="floating">'
        '<parent link="world"/><child link="base"/></joint>',
    )
    assert "the base floats (w), and is held" in text_of(floating)
    assert load_mujoco(floating).joints == ("j0", "j1")
    inner = changed('<joint name="j1" type="revolute">', '<joint name="j1" type="floating">')
    with pytest.raises(ValueError, match="may hang from the root link alone"):
        load_mujoco(inner)
    planar = changed('<joint name="j1" type="revolute">', '<joint name="j1" type="planar">')
    assert "two slides and a hinge each: j1_TX, j1_TY, j1_RZ" in text_of(planar)
    assert load_mujoco(planar).joints == ("j0", "j1_TX", "j1_TY", "j1_RZ")
    with pytest.raises(ValueError, match=r"joint 'j1' is of type 'screw'; those of a URDF are revolute"):
        load_mujoco(changed('<joint name="j1" type="revolute">', '<joint name="j1" type="screw">'))
    with pytest.raises(ValueError, match=r"an inertia that no body can have.*balanceinertia"):
        load_mujoco(changed('iyy="0.0055"', 'iyy="0.5"'))
    bare = changed('<link name="base"/>', '<link name="base"/><link name="lid"><collision><geometry>'
                   '<box size="0.1 0.1 0.1"/></geometry></collision></link><joint name="h" type="continuous">'
                   '<parent link="L1"/><child link="lid"/></joint>')  # fmt: skip
    assert "links lid have no <inertial>" in text_of(bare)
    assert load_mujoco(bare).model.body("lid").mass[0] == pytest.approx(1.0)  # a litre of water
    with pytest.raises(ValueError, match="transmission 't' has the reduction 'two', which is no number"):
        load_spec(changed("<gazebo/>", WRONG))


def test_what_is_no_urdf_is_told(tmp_path: Path) -> None:
    cases = {
        "<robot": "no XML",
        "<mujoco/>": "its root is <mujoco> and not <robot>",
        "<robot/>": r"links without a parent are \[\]",
        f"<robot {XACRO}><xacro:arm/></robot>": "expand them first: xacro arm",
    }
    for text, message in cases.items():
        (tmp_path / "arm.urdf").write_text(text)
        with pytest.raises(ValueError, match=message):
            load_mujoco(tmp_path / "arm.urdf")
    with pytest.raises(FileNotFoundError, match="no such file"):
        load_mujoco(tmp_path / "gone.urdf")
    assert check_urdf(tmp_path / "arm.xml") == ()
