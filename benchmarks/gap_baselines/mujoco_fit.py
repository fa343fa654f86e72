"""Fit every change that MuJoCo's own identification toolbox offers, and take the lowest held-out error.

A mechanism is identified on the nominal motions and then frozen. On the real ones each joint may gain
damping, drag, dry friction, stiffness, hardening or armature, each motor change its gain, and a delay may
lie between inputs and coordinates: one change at a time, fitted to every other window and judged on the rest.
"""

import contextlib
import io
from collections.abc import Sequence
from dataclasses import dataclass, replace

import mujoco
import numpy as np
from mujoco import sysid

from benchmarks.gap_baselines.case import Case
from benchmarks.gap_baselines.contest import choose_by_error
from benchmarks.gap_baselines.mujoco_model import KINDS, Drawn, draw, gear_field, joint_field
from benchmarks.gap_baselines.said import Said, weigh
from lagsplat.diagnose.core.config import HOLDOUT, DiagnoseConfig
from lagsplat.diagnose.core.result import Block
from lagsplat.diagnose.data_quality.natural_period import estimate_spectral_period_s
from lagsplat.diagnose.estimation.dataset import PreparedDataset, WindowSet, cut_windows, prepare_dataset
from lagsplat.io.trajectory.trajectory import Trajectory

ITERATIONS, NOMINAL_ITERATIONS = 12, 40
"""Steps of a fit at most, of one change and of a whole mechanism."""
PERIODS = 1.5
"""Length of a stretch, in rms periods of the motion."""
WINDOWS, HELD = 6, 24
"""Stretches that a fit looks at, and others that it is judged on, at most."""
EXPRESSED = 0.2
"""RMS of the nominal residual, in the coordinates' rms, beyond which no mechanism of MuJoCo is the sim."""
DELAY_S = 0.1
DELAY_PERIODS = 0.1
"""Bound of a delay in rms periods, where it is tighter."""


Window = tuple[np.ndarray, np.ndarray, np.ndarray]
"""Times (n,), measured and simulated coordinates (n, d)."""


class DivergedError(Exception):
    """A rollout left every bound, and the toolbox goes no further."""


@dataclass(frozen=True)
class Change:
    """A parameter that may differ on the real motions: its effect, joint and motor."""

    parameter: sysid.Parameter
    effect: str
    joint: int | None = None
    motor: int | None = None

    @property
    def reference(self) -> float:
        """Its value in the sim."""
        return float(self.parameter.nominal[0])


@dataclass(frozen=True)
class Fitted:
    """Parameters with the half widths of their 95 % intervals, and measured and simulated windows."""

    parameters: sysid.ParameterDict
    half_width: np.ndarray
    windows: list[Window]

    @property
    def vector(self) -> np.ndarray:
        """The fitted values."""
        return np.asarray(self.parameters.as_vector())


@dataclass(frozen=True)
class Bench:
    """A mechanism and the windows that it is fitted to; each begins at the smoothed state."""

    spec: mujoco.MjSpec
    ready: PreparedDataset
    windows: WindowSet
    latest_s: float = 0.0  # longest delay

    def subset(self, remainder: int, most: int) -> "Bench":
        """Every other window, ``most`` of them at most, evenly spread."""
        number = np.arange(remainder, len(self.windows.first), 2)
        if not len(number):
            raise ValueError("a single window is left, and none to hold out; record longer")
        chosen = number[np.unique(np.linspace(0, len(number) - 1, most).astype(int))]
        mask = np.isin(np.arange(len(self.windows.first)), chosen)
        return replace(self, windows=self.windows.select(mask))

    def simulate(self, parameters: sysid.ParameterDict) -> list[Window]:
        """Times, measured and simulated coordinates of every window."""
        _, simulated, measured = self._residual()(parameters.as_vector(), parameters.copy())
        return _windows(measured, simulated)

    def fit(self, parameters: sysid.ParameterDict, *, iterations: int = ITERATIONS) -> Fitted:
        """Least squares in the rms of each coordinate."""
        residual = self._residual()
        with contextlib.redirect_stdout(io.StringIO()):  # it prints every iteration, whatever it is told
            found, result = sysid.optimize(
                parameters.move_off_bounds(),
                residual,
                optimizer="mujoco",
                verbose=False,
                max_iters=iterations,
            )
        left, simulated, measured = residual(found.as_vector(), found.copy())
        flat = [part.ravel() for part in left]
        _, half_width = sysid.calculate_intervals(flat, np.asarray(result.jac), alpha=0.05)
        return Fitted(found, np.asarray(half_width).ravel(), _windows(measured, simulated))

    def _residual(self):
        rms, latest = np.std(self.ready.dataset.q, axis=0), self.latest_s
        spec = self.spec.copy()  # the toolbox writes parameters into the one that it is given
        model = spec.compile()

        def compare(params, predicted, measured, model, return_pred_all, state=None, sensor_weights=None):
            late = float(params["delay"].value[0]) if "delay" in params else 0.0
            # not its sensors, which show the state a step ago
            now = sysid.TimeSeries(state[:, 0], state[:, 1 : 1 + model.nq], measured.signal_mapping)
            shown = sysid.apply_delayed_ts_window(measured, now, -latest, latest)
            moved = sysid.apply_resample_and_delay(now, shown.times, late)
            wrong = (shown.data - moved.data) / rms
            return np.where(np.isfinite(wrong), wrong, 1e3), moved, shown

        pairs = enumerate(zip(self.windows.first, self.windows.length, strict=True))
        parts = [_sequence(spec, model, self.ready, first, length, k) for k, (first, length) in pairs]
        inner = sysid.build_residual_fn(models_sequences=parts, modify_residual=compare, n_threads=1)

        def residual(*arguments, **more):
            try:
                return inner(*arguments, **more)
            except ValueError as error:
                if "strictly increasing" not in str(error):  # what the toolbox says of a rollout that stopped
                    raise
                raise DivergedError(str(error)) from error

        return residual


def mujoco_sysid(case: Case, config: DiagnoseConfig) -> Said:
    """The change with the lowest held-out error, or ``none``.

    Raises:
        ValueError: no mechanism that MuJoCo expresses tells the nominal motions, or too few windows.
    """
    # trials diverge, which `DivergedError` tells; MuJoCo would list each in a file where the program runs
    mujoco.set_mju_user_warning(lambda message: None)
    drawn, misfit = _nominal(case.sim, case.d)
    if misfit > EXPRESSED:
        raise ValueError(
            f"the best of {KINDS.get(case.d, ())} leaves {misfit:.2f} of the rms of the nominal motions; "
            "MuJoCo does not express this mechanism"
        )
    period_s = estimate_spectral_period_s(case.real)
    ready = prepare_dataset(case.real, period_s=period_s)
    windows = cut_windows(ready.dataset, length_s=PERIODS * period_s, min_frames=12)
    whole = Bench(drawn.spec, ready, windows, min(DELAY_S, DELAY_PERIODS * period_s))
    bench, held = whole.subset(0, WINDOWS), whole.subset(1, HELD)
    rms = np.std(ready.dataset.q, axis=0)
    shown = {"none": held.simulate(sysid.ParameterDict())}
    squares = {"none": _squares(shown["none"], rms)}
    best: dict[str, tuple[Change, Fitted]] = {}
    for change in _changes(drawn, whole):
        parameters = sysid.ParameterDict()
        parameters.add(change.parameter)
        try:
            fitted = bench.fit(parameters)
            forecast = held.simulate(fitted.parameters)
        except DivergedError:
            continue
        error = _squares(forecast, rms)
        if change.effect not in squares or error.mean() < squares[change.effect].mean():
            shown[change.effect], squares[change.effect] = forecast, error
            best[change.effect] = change, fitted
    first, scores = choose_by_error(squares)
    if first == "none":
        return Said(weigh(scores, first))
    change, fitted = best[first]
    return Said(
        weigh(scores, first),
        None if change.joint is None else case.real[0].q_names[change.joint],
        None if change.motor is None else case.real[0].u_names[change.motor],
        _published(change, float(fitted.vector[0]), float(fitted.half_width[0]), drawn.spec.copy().compile()),
        _blocks(case.real[0].source, shown["none"], shown[first]),
    )


def _windows(measured: list, simulated: list) -> list[Window]:
    """The toolbox lists the windows of each model; here every model has one."""
    pairs = zip(measured, simulated, strict=True)
    return [(real.times, real.data, sim.data) for (real,), (sim,) in pairs]


def _squares(windows: list[Window], rms: np.ndarray) -> np.ndarray:
    """Mean square error of every window past its start, in the rms of each coordinate, bounded."""
    every = [((real - sim) / rms)[HOLDOUT.start_samples :] for _, real, sim in windows]
    most = HOLDOUT.most_error**2
    return np.array([min(float(np.nan_to_num(np.mean(e**2), nan=most, posinf=most)), most) for e in every])


def _blocks(file: str, sim: Sequence[Window], augmented: Sequence[Window]) -> tuple[Block, ...]:
    return tuple(
        Block(file, k, time, real, before, after)
        for k, ((time, real, before), (_, _, after)) in enumerate(zip(sim, augmented, strict=True))
    )


def _nominal(motions: tuple[Trajectory, ...], d: int) -> tuple[Drawn, float]:
    """The mechanism that tells the nominal motions best, its parameters written into it, and its misfit."""
    period_s = estimate_spectral_period_s(motions)
    ready = prepare_dataset(motions, period_s=period_s)
    best: tuple[Drawn, float] | None = None
    for kind in KINDS.get(d, ()):
        size = float(np.abs(ready.dataset.smooth).max())
        drawn = draw(kind, d, ready.dataset.u.shape[1], guess_s=period_s, dt_s=ready.dataset.dt_s, size=size)
        windows = cut_windows(ready.dataset, length_s=period_s, min_frames=12)
        bench = Bench(drawn.spec, ready, windows).subset(0, WINDOWS)
        try:
            fitted = bench.fit(drawn.parameters, iterations=NOMINAL_ITERATIONS)
        except DivergedError:
            continue  # this is not the mechanism
        misfit = float(np.sqrt(_squares(fitted.windows, np.std(ready.dataset.q, axis=0)).mean()))
        drawn.parameters.update_from_vector(fitted.vector)
        spec = sysid.apply_param_modifiers_spec(drawn.parameters, drawn.spec.copy())
        if best is None or misfit < best[1]:
            best = (replace(drawn, spec=spec), misfit)
    if best is None:
        raise ValueError(
            f"no mechanism of {d} coordinates among {KINDS.get(d, ())} tells the nominal motions"
        )
    return best


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
        sysid.create_initial_state(model, ready.dataset.smooth[first], record.v[first]),
        sysid.TimeSeries.from_control_names(time, control, model),
        sysid.TimeSeries.from_names(time, record.q[cut], model),
    )


def _changes(drawn: Drawn, bench: Bench) -> list[Change]:
    """Every change that the toolbox is offered."""
    ready = bench.ready
    inertia = _inertia(drawn.spec.copy().compile(), ready)
    rms, speed = np.std(ready.dataset.q, axis=0), np.sqrt(np.mean(ready.dataset.v**2, axis=0))
    bend = inertia * np.sqrt(np.mean(ready.acceleration**2, axis=0))
    changes = []

    def add(effect: str, key: str, value: float, low: float, high: float, write, joint=None, motor=None):
        changes.append(Change(sysid.Parameter(key, value, low, high, modifier=write), effect, joint, motor))

    for i in range(len(inertia)):
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
        changes.append(Change(sysid.Parameter("delay", 0.0, -bench.latest_s, bench.latest_s), "input_delay"))
    return changes


def _inertia(model: mujoco.MjModel, ready: PreparedDataset) -> np.ndarray:
    """Diagonal of the inertia matrix in the middle of the motion."""
    data = mujoco.MjData(model)
    data.qpos[:] = np.median(ready.dataset.smooth, axis=0)
    mujoco.mj_forward(model, data)
    whole = np.zeros((model.nv, model.nv))
    mujoco.mj_fullM(model, data, whole)
    return np.diag(whole).copy()


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
