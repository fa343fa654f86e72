"""Parameters of MuJoCo's identification toolbox: by its own files, into a model and out of two."""

from pathlib import Path

import numpy as np
import pytest

from lagsplat.diagnose.simulators.mujoco_model import make_mujoco_fields
from lagsplat.io.files.sysid_yaml import read_sysid_parameters, write_sysid_parameters
from lagsplat.io.mujoco.body_inertia import pack_inertia
from lagsplat.io.mujoco.model import load_mujoco, load_spec
from lagsplat.io.mujoco.sysid_parameters import list_sysid_parameters
from tests.unit.io.mujoco.urdf_files import TWO, write_urdf

sysid = pytest.importorskip("mujoco.sysid")
model_modifier = pytest.importorskip("mujoco.sysid").model_modifier
mujoco = pytest.importorskip("mujoco")
MODEL = """<mujoco><worldbody><body name="upper"><joint name="a" axis="0 1 0" damping="0.1"/>
<inertial pos="0 0.01 -0.3" mass="1.2" diaginertia="0.02 0.021 0.004"/><geom size="0.01"/>
<body name="fore" pos="0 0 -0.6"><joint name="b" axis="0 1 0" stiffness="2" springref="5"/>
<geom type="capsule" fromto="0 0 0 0 0 -0.4" size="0.03" mass="0.6"/></body></body></worldbody>
<actuator><motor name="m" joint="a" gear="2"/><position name="hold" joint="b" kp="4" kv="0.2"/></actuator>
</mujoco>"""

REST = "nominal: [1], min_value: [0], max_value: [2], frozen: false"


@pytest.fixture
def model(tmp_path: Path) -> Path:
    (tmp_path / "arm.xml").write_text(MODEL)
    return tmp_path / "arm.xml"


def save(path: Path, **values: object) -> str:
    """Save parameters as the toolbox does after a fit: the values differ from what it started from."""
    parameters = sysid.ParameterDict()
    for name, value in values.items():
        one = sysid.Parameter(name, np.zeros_like(value, dtype=float), -100.0, 100.0)
        one.min_value, one.max_value = (np.full(one.nominal.shape, x) for x in (-100.0, 100.0))
        one.value = np.atleast_1d(np.asarray(value, dtype=float))
        parameters.add(one)
    parameters.save_to_disk(path)
    return str(path)


def test_identified_values_replace_those_of_the_model(model: Path, tmp_path: Path) -> None:
    file = save(
        tmp_path / "params_x_hat.yaml",
        a_damping=0.35, a_frictionloss=0.2, b_armature=0.01, b_stiffness=3.0, m_gear=1.7, hold_pgain=6.0,
        hold_dgain=0.5, upper_mass=1.5,
    )  # fmt: skip
    found = load_mujoco(model, parameters=file).model
    assert np.ravel(found.joint("a").damping)[0] == 0.35
    assert found.joint("a").frictionloss[0] == 0.2
    assert found.joint("b").armature[0] == 0.01
    assert np.ravel(found.joint("b").stiffness)[0] == 3.0
    assert found.actuator("m").gear[0] == 1.7
    assert found.actuator("hold").gainprm[0] == 6.0
    assert found.actuator("hold").biasprm[:3].tolist() == [0.0, -6.0, -0.5]
    assert found.body("upper").mass[0] == 1.5
    assert np.ravel(load_mujoco(model).model.joint("a").damping)[0] == 0.1


def test_an_inertia_of_the_toolbox_is_the_one_it_builds(model: Path, tmp_path: Path) -> None:
    for kind in sysid.InertiaType:
        spec = mujoco.MjSpec.from_file(str(model))
        one = sysid.body_inertia_param(spec.copy(), spec.copy().compile(), "fore", kind)
        if kind is sysid.InertiaType.Pseudo:
            ours = pack_inertia(spec, "fore")
            np.testing.assert_allclose(ours, one.as_vector(), rtol=1e-9, atol=1e-12)
        one.update_from_vector(1.07 * one.as_vector())
        parameters = sysid.ParameterDict({one.name: one})
        parameters.save_to_disk(tmp_path / "inertia.yaml")
        found = load_mujoco(model, parameters=str(tmp_path / "inertia.yaml")).model.body("fore")
        given = spec.copy().compile().body("fore")
        value = one.value.ravel()
        if kind is sysid.InertiaType.Pseudo:
            mass, *first = model_modifier.pi_from_theta(value)[:4]
            about = model_modifier.pi_from_theta(value)[4:].reshape(3, 3)
            center = np.array(first) / mass
            about -= mass * (center @ center * np.eye(3) - np.outer(center, center))
            assert found.mass[0] == pytest.approx(mass, rel=1e-9)
            np.testing.assert_allclose(found.ipos, center, atol=1e-12)
            np.testing.assert_allclose(np.sort(found.inertia), np.linalg.eigvalsh(about), rtol=1e-9)
        else:
            assert found.mass[0] == value[0]
            np.testing.assert_allclose(found.ipos, value[1:] if value.size == 4 else given.ipos)
            np.testing.assert_allclose(found.inertia, given.inertia, rtol=1e-12)


def test_names_that_say_nothing_of_the_model_are_told(model: Path, tmp_path: Path) -> None:
    file = save(tmp_path / "p.yaml", damping_of_a=1.0)
    with pytest.raises(
        ValueError, match=r"p\.yaml: parameter 'damping_of_a' names no element of arm\.xml.*save_resul"
    ):
        load_spec(model, file)
    frozen = sysid.ParameterDict({"x": sysid.Parameter("x", 1.0, 0.0, 2.0, frozen=True)})
    frozen.save_to_disk(tmp_path / "frozen.yaml")
    load_spec(model, str(tmp_path / "frozen.yaml"))
    with pytest.raises(ValueError, match=r"'m_gear' of .* does not fit \(gear has 6 number"):
        load_spec(model, save(tmp_path / "p.yaml", m_gear=np.ones(7)))
    with pytest.raises(ValueError, match="a mass of -1; give one above zero"):
        load_spec(model, save(tmp_path / "p.yaml", fore_mass=-1.0))
    with pytest.raises(ValueError, match="an inertia has 1, 4 or 10 numbers, not 3"):
        load_spec(model, save(tmp_path / "p.yaml", fore_inertia=np.ones(3)))
    cases = {
        "- 1": "no parameters",
        "a: {value: 1}": "parameter 'a' lacks name, nominal",
        "!!python/object/apply:os.getcwd []": "no YAML that holds plain data",
        f"a: {{name: a, value: [x], {REST}}}": "holds no numbers",
        f"a: {{name: a, value: [.nan], {REST}}}": "has shapes",
    }
    for text, message in cases.items():
        (tmp_path / "wrong.yaml").write_text(text)
        with pytest.raises(ValueError, match=message):
            load_spec(model, str(tmp_path / "wrong.yaml"))
    with pytest.raises(FileNotFoundError, match="no such file"):
        load_spec(model, str(tmp_path / "gone.yaml"))


def test_what_two_models_differ_by_is_loaded_by_the_toolbox(model: Path, tmp_path: Path) -> None:
    before, changed = load_spec(model), mujoco.MjSpec.from_file(str(model))
    changed.joint("a").damping = [0.4, 0.05, 0.0]
    changed.joint("b").frictionloss = 0.3
    changed.actuator("m").gear[0] = -1.5
    changed.actuator("m").delay, changed.actuator("m").nsample = 0.02, 20
    changed.body("upper").mass = 1.9
    changed.compile()
    (tmp_path / "patched.xml").write_text(changed.to_xml())
    parameters, others = list_sysid_parameters(before, load_spec(tmp_path / "patched.xml"))
    write_sysid_parameters(tmp_path / "params_x_hat.yaml", parameters)
    loaded = sysid.ParameterDict.load_from_disk(tmp_path / "params_x_hat.yaml")
    assert sorted(loaded.keys()) == ["a_damping", "b_frictionloss", "m_gear", "upper_inertia"]
    assert loaded["a_damping"].value.tolist() == [0.4, 0.05]
    assert loaded["a_damping"].nominal.tolist() == [0.1, 0.0]
    assert loaded["m_gear"].min_value[0] == -20.0
    low, high = loaded.get_bounds()
    assert (low <= loaded.as_vector()).all()
    assert (loaded.as_vector() <= high).all()
    assert len(others) == 1
    assert "delay" in others[0]
    again = read_sysid_parameters(tmp_path / "params_x_hat.yaml")
    assert [each.name for each in again] == loaded.keys()
    file = str(tmp_path / "params_x_hat.yaml")
    ours, theirs = load_mujoco(model, parameters=file), load_mujoco(tmp_path / "patched.xml")
    for name in ("dof_damping", "dof_frictionloss", "actuator_gear", "body_mass"):
        np.testing.assert_allclose(getattr(ours.model, name), getattr(theirs.model, name), rtol=1e-5)
    q = np.random.default_rng(0).uniform(-2.0, 2.0, (10, 2))
    for name in ("mass", "potential_gradient"):
        one, other = (getattr(make_mujoco_fields(each), name)(q) for each in (ours, theirs))
        np.testing.assert_allclose(one, other, rtol=1e-5, atol=1e-5)


def test_links_of_a_urdf_that_are_fixed_to_one_another_are_one_body(tmp_path: Path) -> None:
    tool = """<link name="tool"><inertial><mass value="0.2"/>
    <inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
    <joint name="f" type="fixed"><parent link="L1"/><child link="tool"/></joint>"""
    arm = write_urdf(tmp_path / "arm.urdf", TWO, extra=tool)
    file = save(tmp_path / "p.yaml", L0_mass=2.0)
    assert load_mujoco(arm, parameters=file).model.body("L0").mass[0] == 2.0
    with pytest.raises(ValueError, match=r"'L1_mass' of .*MuJoCo adds 0.2 of bodies that are fixed to it"):
        load_spec(arm, save(tmp_path / "p.yaml", L1_mass=2.0))
    changed = load_spec(arm)
    changed.body("L1").mass = 1.5
    changed.compile()
    (tmp_path / "patched.xml").write_text(changed.to_xml())
    parameters, (other,) = list_sysid_parameters(load_spec(arm), load_spec(tmp_path / "patched.xml"))
    assert parameters == ()
    assert other.startswith("L1_inertia (MuJoCo adds 0.2")
