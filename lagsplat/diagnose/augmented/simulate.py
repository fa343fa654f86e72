"""Run an augmented simulator under given inputs and pushes, and the acceleration that its effects add."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.augmented.model import AugmentedSimulator
from lagsplat.diagnose.effects.base import InputEffect
from lagsplat.diagnose.estimation.dataset import Dataset, WindowSet
from lagsplat.diagnose.estimation.rollout import RolloutModel
from lagsplat.diagnose.mechanics.structure import COEFFICIENT_FIELDS

Vector = Float64[np.ndarray, " d"]


@dataclass(frozen=True)
class AppliedSignals:
    """Instants [s], which may be uneven, with inputs and with pushes along every coordinate.

    A push is a generalised force over the reference inertia at rest: the acceleration [1/s^2] that it would
    give its coordinate if that one moved alone.
    """

    time_s: Float64[np.ndarray, " N"]
    u: Float64[np.ndarray, "N n_u"]
    push: Float64[np.ndarray, "N d"] | None = None


def simulate_augmented(
    simulator: AugmentedSimulator,
    signals: AppliedSignals,
    *,
    q: Float64[np.ndarray, " d"] | None = None,
    v: Float64[np.ndarray, " d"] | None = None,
    held: bool | None = None,
) -> tuple[Float64[np.ndarray, "N d"], Float64[np.ndarray, "N d"]]:
    """Coordinates as a sensor would see them, and their rates, at the instants of ``signals``.

    It starts at ``q``, by default the rest of the simulator, with velocity ``v``, by default zero. ``held``
    says whether inputs are held between samples, by default as in the simulator.

    Raises:
        ValueError: another number of inputs, pushes or coordinates than the simulator's, less than two
            instants, or times that do not increase.
    """
    d, n = simulator.model.d, len(signals.time_s)
    at = [simulator.model.rest if q is None else q, np.zeros(d) if v is None else v]
    if signals.u.shape != (n, simulator.model.n_u):
        names = ", ".join(simulator.u_names)
        raise ValueError(
            f"{signals.u.shape[1]} input column(s), but the sim has {simulator.model.n_u}: {names}"
        )
    if signals.push is not None and signals.push.shape != (n, d):
        raise ValueError(f"{signals.push.shape[1]} column(s) of pushes f, but the sim has {d} coordinate(s)")
    if any(len(x) != d for x in at):
        sizes = " + ".join(str(len(x)) for x in at)
        raise ValueError(f"the initial state has {sizes} numbers, where {d} + {d} are wanted")
    if n < 2 or not (np.diff(signals.time_s) > 0.0).all():
        raise ValueError("give at least two instants, with times that increase")
    u = signals.u
    if signals.push is not None:
        simulator, u = _add_push_inputs(simulator), np.concatenate([u, signals.push], axis=1)
    held_q, held_v = (np.repeat(x[None], n, axis=0) for x in at)
    time = np.ascontiguousarray(signals.time_s, dtype=np.float64)
    dataset = Dataset.single_clip(time, held_q, held_v, u)
    steps = max(1, int(np.ceil(np.diff(signals.time_s).max() / simulator.step_s - 1e-9)))
    held = simulator.held if held is None else held
    rollout_model = RolloutModel(simulator.model, dataset, simulator.nuisance, steps, held)
    start = np.concatenate(at)[None, None]
    window = WindowSet(np.zeros(1, dtype=np.int64), np.array([n]))
    y, rate = rollout_model.roll_out(simulator.effects, simulator.x[None], start, window)
    return y[0, 0], rate[0, 0]


def compute_missing_acceleration(
    simulator: AugmentedSimulator, q: Vector, v: Vector, u: Float64[np.ndarray, " n_u"]
) -> Vector:
    """What the effects add to the acceleration [1/s^2] at a state and its velocity under held inputs.

    The simulator with and without its effects is compared over one step. Effects with a memory begin anew,
    and those at instants of the recording act as at its start.

    Raises:
        ValueError: as `simulate_augmented`.
    """
    plain = replace(simulator, effects=(), x=simulator.split_unknowns()[-1])
    signals = AppliedSignals(np.array([0.0, simulator.step_s]), np.stack([u, u]))
    after, without = (simulate_augmented(each, signals, q=q, v=v)[1][1] for each in (simulator, plain))
    return (after - without) / simulator.step_s


def _add_push_inputs(simulator: AugmentedSimulator) -> AugmentedSimulator:
    """The same with one more input for each coordinate, a force that no effect and no uncertainty changes."""
    model, nuisance, d, n_u = simulator.model, simulator.nuisance, simulator.model.d, simulator.model.n_u
    rows = len(model.input_map)
    input_map = np.zeros((max(rows, 1), n_u + d, d))
    input_map[:rows, :n_u] = model.input_map
    input_map[0, n_u:] = np.diag(np.diag(model.inertia))
    known = {name: np.ones(getattr(model, name).shape, dtype=bool) for name in COEFFICIENT_FIELDS}
    known["input_map"] = np.zeros(input_map.shape, dtype=bool)
    known["input_map"][:rows, :n_u] = True
    kept = np.concatenate([known[name].ravel() for name in COEFFICIENT_FIELDS])
    directions = np.zeros((len(nuisance.directions), kept.size))
    directions[:, kept] = nuisance.directions
    effects, unknowns = [], []
    *of_effects, of_nuisance = simulator.split_unknowns()
    for placed, x in zip(simulator.effects, of_effects, strict=True):
        # an effect of all inputs at once becomes one of each, so that it leaves the pushes alone
        on_inputs = isinstance(placed.effect, InputEffect)
        for channel in placed.list_channels(n_u) if on_inputs else [placed.channel]:
            effects.append(replace(placed, channel=channel))
            unknowns.append(x)
    gains = 2 + n_u  # the nuisance parameters begin with two of the mechanism and the gain of each input
    return replace(
        simulator,
        model=replace(model, input_map=input_map),
        nuisance=replace(nuisance, n_u=n_u + d, directions=directions),
        effects=tuple(effects),
        x=np.concatenate([*unknowns, of_nuisance[:gains], np.zeros(d), of_nuisance[gains:]]),
    )
