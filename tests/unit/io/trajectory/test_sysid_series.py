"""Series of MuJoCo's identification toolbox, written and loaded by the toolbox itself."""

from pathlib import Path

import numpy as np
import pytest

import lagsplat
from lagsplat.io.sources import find_sources, read_sources
from lagsplat.io.trajectory.sysid_series import CONTROL, POSITION, Signal, write_series

sysid = pytest.importorskip("mujoco.sysid")
mujoco = pytest.importorskip("mujoco")
MODEL = """<mujoco><worldbody><body><joint name="a" axis="0 1 0"/><geom size="0.1" pos="0 0 -0.3"/>
<body pos="0 0 -0.6"><joint name="b" axis="0 1 0"/><geom size="0.1" pos="0 0 -0.3"/></body></body></worldbody>
<actuator><motor name="m" joint="a"/><motor name="n" joint="b"/></actuator>
<sensor><jointpos name="a_sensor" joint="a"/><jointpos name="b_sensor" joint="b"/></sensor></mujoco>"""


def signals(n: int = 50) -> tuple[np.ndarray, np.ndarray, np.ndarray, np.ndarray]:
    t = np.linspace(0.0, 1.0, n)
    wave = np.stack([np.sin(k * t) for k in range(1, 7)], axis=1)
    return t, wave[:, :2], wave[:, 2:4], wave[:, 4:]


def test_a_series_of_the_toolbox_is_a_trajectory(tmp_path: Path) -> None:
    model = mujoco.MjModel.from_xml_string(MODEL)
    t, q, v, u = signals()
    names = ["b_qvel", "a_qvel", "a_qpos", "b_qpos"]
    measured = sysid.TimeSeries.from_names(t, np.concatenate([v[:, ::-1], q], axis=1), model, names)
    measured.save_to_disk(tmp_path / "log.npz")
    alone = lagsplat.read_trajectory(tmp_path / "log.npz")
    assert alone.n_u == 0
    assert kinds(tmp_path) == ["log.npz"]
    np.testing.assert_array_equal(alone.q, q)
    np.testing.assert_array_equal(alone.v, v)
    control = sysid.TimeSeries.from_control_names(t, u, model)
    control.save_to_disk(tmp_path / "log_control.npz")
    both = lagsplat.read_trajectory(tmp_path / "log.npz")
    np.testing.assert_array_equal(both.u, u)
    assert kinds(tmp_path) == ["log.npz"]
    (from_folder,) = read_sources(find_sources(str(tmp_path)))
    np.testing.assert_array_equal(from_folder.u, u)
    turned = lagsplat.read_trajectory(tmp_path / "log.npz", columns={"q0": "b_qpos", "q1": "a_qpos"})
    np.testing.assert_array_equal(turned.q, q[:, ::-1])
    np.testing.assert_array_equal(turned.u, u)


def kinds(folder: Path) -> list[str]:
    return [Path(source.path).name for source in find_sources(str(folder))]


def test_sensors_are_named_by_the_user(tmp_path: Path) -> None:
    model = mujoco.MjModel.from_xml_string(MODEL)
    t, q, _, _ = signals()
    sysid.TimeSeries.from_names(t, q, model).save_to_disk(tmp_path / "sensors.npz")
    with pytest.raises(ValueError, match=r"no column q0; the columns are \['t', 'a_sensor', 'b_sensor'\]"):
        lagsplat.read_trajectory(tmp_path / "sensors.npz")
    named = {"q0": "a_sensor", "q1": "b_sensor"}
    np.testing.assert_array_equal(lagsplat.read_trajectory(tmp_path / "sensors.npz", columns=named).q, q)
    sysid.TimeSeries(t, q).save_to_disk(tmp_path / "bare.npz")
    bare = lagsplat.read_trajectory(tmp_path / "bare.npz", columns={"q0": "data[0]", "q1": "data[1]"})
    np.testing.assert_array_equal(bare.q, q)


@pytest.mark.filterwarnings("ignore:.*are not used")
def test_a_whole_trajectory_of_the_toolbox(tmp_path: Path) -> None:
    model = mujoco.MjModel.from_xml_string(MODEL)
    t, q, v, u = signals()
    late = t - 0.5 * t[1]
    trajectory = sysid.SystemTrajectory(
        model=model,
        control=sysid.TimeSeries.from_control_names(late, u, model),
        sensordata=sysid.TimeSeries.from_names(t, q, model),
        initial_state=sysid.create_initial_state(model, q[0], v[0]),
        state=None,
    )
    trajectory.save_to_disk(tmp_path / "real.npz")
    sensors = {"q0": "a_sensor", "q1": "b_sensor"}
    with pytest.warns(UserWarning, match="1 of 50 rows lack a number"):  # no control acts at the last one
        real = lagsplat.read_trajectory(tmp_path / "real.npz", columns=sensors)
    np.testing.assert_array_equal(real.q, q[:-1])
    expected = [np.interp(t[:-1], late, column) for column in u.T]
    np.testing.assert_allclose(real.u, np.stack(expected, axis=1), atol=1e-14)
    full = np.concatenate([t[:, None], q, v], axis=1)
    mapping = {
        "a_qpos": (sysid.SignalType.MjStateQPos, 1),
        "b_qpos": (sysid.SignalType.MjStateQPos, 2),
        "a_qvel": (sysid.SignalType.MjStateQVel, 3),
        "b_qvel": (sysid.SignalType.MjStateQVel, 4),
    }
    simulated = trajectory.replace(
        control=sysid.TimeSeries.from_control_names(t, u, model),
        state=sysid.TimeSeries.create(t, full, mapping),
    )
    simulated.save_to_disk(tmp_path / "sim.npz")
    sim = lagsplat.read_trajectory(tmp_path / "sim.npz")
    for ours, theirs in ((sim.q, q), (sim.v, v), (sim.u, u)):
        np.testing.assert_array_equal(ours, theirs)


def test_what_is_written_is_loaded_by_the_toolbox(tmp_path: Path) -> None:
    model = mujoco.MjModel.from_xml_string(MODEL)
    t, q, _, u = signals()
    write_series(
        tmp_path / "x_measured.npz",
        t,
        [Signal(f"{n}_qpos", POSITION, x) for n, x in zip("ab", q.T, strict=True)],
    )
    write_series(
        tmp_path / "x_control.npz",
        t,
        [Signal(f"{n}_ctrl", CONTROL, x) for n, x in zip("mn", u.T, strict=True)],
    )
    measured, control = (
        sysid.TimeSeries.load_from_disk(tmp_path / f"x_{kind}.npz") for kind in ("measured", "control")
    )
    wanted = sysid.TimeSeries.from_names(t, q, model, ["a_qpos", "b_qpos"])
    assert str(measured.signal_mapping) == str(wanted.signal_mapping)
    assert str(control.signal_mapping) == str(sysid.TimeSeries.from_control_names(t, u, model).signal_mapping)
    np.testing.assert_array_equal(measured.data, q)
    np.testing.assert_array_equal(control.data, u)
    motion = lagsplat.read_trajectory(tmp_path / "x_measured.npz")
    np.testing.assert_array_equal(motion.u, u)


def test_what_does_not_fit_is_told(tmp_path: Path) -> None:
    t, q, _, _ = signals()
    cases = {
        r"times of shape \(50,\) and data of shape \(49, 2\)": {"data": q[:-1]},
        "signal_mapping does not name columns": {"data": q, "signal_mapping": np.asarray('{"a": [2, [7]]}')},
        "signal_mapping does not name": {"data": q, "signal_mapping": np.asarray("no JSON")},
    }
    for message, arrays in cases.items():
        np.savez(tmp_path / "wrong.npz", times=t, **arrays)
        with pytest.raises(ValueError, match=message):
            lagsplat.read_trajectory(tmp_path / "wrong.npz")
