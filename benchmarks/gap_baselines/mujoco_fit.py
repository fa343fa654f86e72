"""Fit everything with MuJoCo's own identification toolbox; its largest significant change is its answer.

A mechanism is identified on the nominal motions and then frozen. On the real ones every joint may gain
damping, drag, dry friction, stiffness, hardening and armature, every motor may change its gain, and a delay
may lie between inputs and coordinates. Inertia, stiffness and gains together only set a scale that no motion
shows; so one fit leaves the armature as it is, another one stiffness and gains, and the better one counts.
How large a change is, is how large its force gets on the real motion.
"""

import contextlib
import io
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from mujoco import sysid

from benchmarks.gap_baselines.case import Case
from benchmarks.gap_baselines.mujoco_model import KINDS, Drawn, draw, gear_field, joint_field
from benchmarks.gap_baselines.said import Said
from lagsplat.diagnose.core.config import DiagnoseConfig
from lagsplat.diagnose.data_quality.natural_period import estimate_spectral_period_s
from lagsplat.diagnose.estimation.dataset import PreparedDataset, cut_windows, prepare_dataset
from lagsplat.io.trajectory.trajectory import Trajectory

ITERATIONS = 12
WINDOWS = 6
"""Stretches that a fit looks at, at most."""
EXPRESSED = 0.1
"""RMS of the nominal residual, in the coordinates' rms, beyond which no mechanism of MuJoCo is the sim."""
LEAST = 0.01
"""Share of the inertial force below which a change is none."""
DELAY_S = 0.1
HELD = (("mass_change",), ("linear_stiffness", "input_gain"))
"""Changes that each of the fits does without."""
BETTER = 0.99
"""Share of the first fit's residual that a later one must stay below."""


@dataclass(frozen=True)
class Change:
    """A parameter that may differ on the real motions: its effect, joint and motor, and its bounds."""

    key: str
    effect: str
    joint: int | None
    motor: int | None
    reference: float


def mujoco_sysid(case: Case, config: DiagnoseConfig) -> Said:
    """The effect of the largest significant change, or ``none``.

    Raises:
        ValueError: no mechanism that MuJoCo expresses tells the nominal motions.
    """
    drawn, misfit = _nominal(case.sim, case.d)
    if misfit > EXPRESSED:
        raise ValueError(
            f"the best of {KINDS.get(case.d, ())} leaves {misfit:.2f} of the rms of the nominal motions; "
            "MuJoCo does not express this mechanism"
        )
    period_s = estimate_spectral_period_s(case.real)
    ready = prepare_dataset(case.real, period_s=period_s)
    found = None
    for held in HELD:
        parameters, offered = _changes(drawn, ready, held)
        tried = _fit(drawn.spec, parameters, ready, 2.0 * period_s)
        if found is None or tried[2] < BETTER * found[2]:
            found, changes = tried, offered
    assert found is not None
    fitted, half_width, _ = found
    sizes = {}
    model = drawn.spec.copy().compile()
    force = _inertial(model, ready)
    for k, change in enumerate(changes):
        moved = float(fitted[k]) - change.reference
        if abs(moved) > half_width[k] and np.isfinite(half_width[k]):
            size = abs(moved) * _unit_force(change, model, ready, force)
            if size >= LEAST:
                sizes[k] = size
    if not sizes:
        return Said({"none": 1.0})
    best = max(sizes, key=lambda k: sizes[k])
    shares: dict[str, float] = {}
    for k, size in sizes.items():
        shares[changes[k].effect] = max(shares.get(changes[k].effect, 0.0), size)
    total = sum(shares.values())
    change = changes[best]
    return Said(
        {name: share / total for name, share in shares.items()},
        None if change.joint is None else f"q{change.joint}",
        None if change.motor is None else f"u{change.motor}",
        _published(change, float(fitted[best]), float(half_width[best]), model),
    )


def _nominal(motions: tuple[Trajectory, ...], d: int) -> tuple[Drawn, float]:
    """The mechanism that tells the nominal motions best, its parameters written into it, and its misfit."""
    period_s = estimate_spectral_period_s(motions)
    ready = prepare_dataset(motions, period_s=period_s)
    best: tuple[Drawn, float] | None = None
    for kind in KINDS.get(d, ()):
        size = float(np.abs(ready.smooth).max())
        drawn = draw(kind, d, ready.dataset.u.shape[1], guess_s=period_s, dt_s=ready.dataset.dt_s, size=size)
        fitted, _, misfit = _fit(drawn.spec, drawn.parameters, ready, period_s)
        drawn.parameters.update_from_vector(fitted)
        spec = sysid.apply_param_modifiers_spec(drawn.parameters, drawn.spec.copy())
        if best is None or misfit < best[1]:
            best = (replace(drawn, spec=spec), misfit)
    if best is None:
        raise ValueError(f"no mechanism of {d} coordinates is known")
    return best


def _fit(
    spec: mujoco.MjSpec, parameters: sysid.ParameterDict, ready: PreparedDataset, window_s: float
) -> tuple[np.ndarray, np.ndarray, float]:
    """Best parameters, the half widths of their 95 % intervals, and the rms residual in the rms of each q."""
    record, model = ready.dataset, spec.compile()
    rms = np.std(record.q, axis=0)
    windows = cut_windows(record, length_s=window_s, min_frames=12)
    chosen = np.unique(np.linspace(0, len(windows.first) - 1, WINDOWS).astype(int))
    parts = [_sequence(spec, model, ready, windows.first[k], windows.length[k], k) for k in chosen]
    latest = DELAY_S if "delay" in parameters else 0.0

    def compare(params, predicted, measured, model, return_pred_all, state=None, sensor_weights=None):
        late = float(params["delay"].value[0]) if "delay" in params else 0.0
        # not its sensors, which show the state a step ago
        now = sysid.TimeSeries(state[:, 0], state[:, 1 : 1 + model.nq], measured.signal_mapping)
        shown = sysid.apply_delayed_ts_window(measured, now, -latest, latest)
        moved = sysid.apply_resample_and_delay(now, shown.times, late)
        wrong = (shown.data - moved.data) / rms
        return np.where(np.isfinite(wrong), wrong, 1e3), moved, shown

    residual = sysid.build_residual_fn(models_sequences=parts, modify_residual=compare, n_threads=1)
    with contextlib.redirect_stdout(io.StringIO()):  # it prints every iteration, whatever it is told
        found, result = sysid.optimize(
            parameters.move_off_bounds(), residual, optimizer="mujoco", verbose=False, max_iters=ITERATIONS
        )
    left = [part.ravel() for part in residual(found.as_vector(), found.copy())[0]]
    _, half_width = sysid.calculate_intervals(left, np.asarray(result.jac), alpha=0.05)
    flat = np.concatenate(left)
    return found.as_vector(), np.asarray(half_width).ravel(), float(np.sqrt(np.mean(flat**2)))


def _sequence(
    spec: mujoco.MjSpec, model: mujoco.MjModel, ready: PreparedDataset, first: int, length: int, number: int
) -> sysid.ModelSequences:
    """One window with its smoothed starting state, its inputs copied to the motors of every joint."""
    record, cut = ready.dataset, slice(first, first + length)
    time = record.time[cut] - record.time[first]
    control = np.tile(record.u[cut], (1, record.d))
    return sysid.ModelSequences(
        f"window{number}",
        spec,
        "real",
        sysid.create_initial_state(model, ready.smooth[first], record.v[first]),
        sysid.TimeSeries.from_control_names(time, control, model),
        sysid.TimeSeries.from_names(time, record.q[cut], model),
    )


def _changes(
    drawn: Drawn, ready: PreparedDataset, held: tuple[str, ...]
) -> tuple[sysid.ParameterDict, list[Change]]:
    """Every change that the toolbox is offered but those ``held``, and what each one means."""
    model = drawn.spec.copy().compile()
    inertia = _inertia(model, ready)
    rms, speed = np.std(ready.dataset.q, axis=0), np.sqrt(np.mean(ready.dataset.v**2, axis=0))
    bend = inertia * np.sqrt(np.mean(ready.acceleration**2, axis=0))
    out, changes = sysid.ParameterDict(), []

    def add(effect: str, key: str, value: float, low: float, high: float, write, joint=None, motor=None):
        if effect not in held:
            out.add(sysid.Parameter(key, value, low, high, modifier=write))
            changes.append(Change(key, effect, joint, motor, value))

    for i in range(model.nv):
        own, q = drawn.spec.joint(f"q{i}"), f"q{i}"
        linear = bend[i] / speed[i]
        c, k = float(own.damping[0]), float(own.stiffness[0])
        add("viscous_damping", f"damping{i}", c, 0.0, c + linear, joint_field(q, "damping"), i)
        add("quadratic_drag", f"drag{i}", 0.0, -1e-9, linear / speed[i], joint_field(q, "damping", 1), i)
        add("coulomb_friction", f"dry{i}", 0.0, -1e-9, bend[i], joint_field(q, "frictionloss", None), i)
        reach = bend[i] / rms[i]
        add("linear_stiffness", f"stiffness{i}", k, k - reach, k + reach, joint_field(q, "stiffness"), i)
        old = float(own.stiffness[2])
        cubic = reach / rms[i] ** 2
        add("cubic_stiffness", f"cubic{i}", old, old - cubic, old + cubic, joint_field(q, "stiffness", 2), i)
        add(
            "mass_change",
            f"armature{i}",
            0.0,
            -0.5 * inertia[i],
            2.0 * inertia[i],
            joint_field(q, "armature", None),
            i,
        )
    for motor in drawn.spec.actuators:
        i, j = (int(part) for part in motor.name[1:].split("_"))
        gear = float(motor.gear[0])
        if abs(gear) > 0.0 and np.ptp(ready.dataset.u[:, j]) > 0.0:
            wide = 2.0 * abs(gear)
            add("input_gain", f"gear{i}_{j}", gear, gear - wide, gear + wide, gear_field(motor.name), i, j)
    if ready.dataset.u.shape[1]:
        out.add(sysid.Parameter("delay", 0.0, -DELAY_S, DELAY_S))
        changes.append(Change("delay", "input_delay", None, None, 0.0))
    return out, changes


def _inertia(model: mujoco.MjModel, ready: PreparedDataset) -> np.ndarray:
    """Diagonal of the inertia matrix in the middle of the motion."""
    data = mujoco.MjData(model)
    data.qpos[:] = np.median(ready.smooth, axis=0)
    mujoco.mj_forward(model, data)
    whole = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, whole)
    return np.diag(whole).copy()


def _inertial(model: mujoco.MjModel, ready: PreparedDataset) -> np.ndarray:
    """RMS inertial force of every joint."""
    return _inertia(model, ready) * np.sqrt(np.mean(ready.acceleration**2, axis=0))


def _unit_force(change: Change, model: mujoco.MjModel, ready: PreparedDataset, force: np.ndarray) -> float:
    """RMS force of a unit of change, in the inertial force of its joint; of a delay the shift it makes."""
    record = ready.dataset
    if change.joint is None:
        speed = np.sqrt(np.mean(record.v**2, axis=0))
        return float(np.max(speed / np.std(record.q, axis=0)))
    i = change.joint
    q, v, a = ready.smooth[:, i], record.v[:, i], ready.acceleration[:, i]
    shape = {
        "viscous_damping": v,
        "quadratic_drag": np.abs(v) * v,
        "coulomb_friction": np.ones_like(v),
        "linear_stiffness": q,
        "cubic_stiffness": q**3,
        "mass_change": a,
        "input_gain": record.u[:, change.motor or 0] if change.motor is not None else v,
    }[change.effect]
    return float(np.sqrt(np.mean(shape**2)) / force[i])


def _published(
    change: Change, value: float, half: float, model: mujoco.MjModel
) -> dict[str, tuple[float, float, float]]:
    """The parameter in the words of a diagnosis, where its unit is one of accelerations or seconds."""
    if change.effect == "input_delay":
        return {"delay": (value, value - half, value + half)}
    if change.effect == "input_gain":
        ratio, width = value / change.reference, abs(half / change.reference)
        return {"ratio": (ratio, ratio - width, ratio + width)}
    keys = {
        "viscous_damping": "rate",
        "quadratic_drag": "coefficient",
        "coulomb_friction": "acceleration",
        "cubic_stiffness": "coefficient",
    }
    if change.effect not in keys or change.joint is None:
        return {}
    data = mujoco.MjData(model)
    mujoco.mj_forward(model, data)
    whole = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, whole)
    unit = whole[change.joint, change.joint]
    moved, width = (value - change.reference) / unit, half / unit
    return {keys[change.effect]: (moved, moved - width, moved + width)}
