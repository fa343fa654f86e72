"""Run an augmented simulator under given inputs and pushes, and the acceleration that its effects add."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.augmented.model import AugmentedSimulator
from lagsplat.diagnose.effects.base import CoefficientBatch, InputEffect, PlacedEffect
from lagsplat.diagnose.estimation.dataset import Dataset, WindowSet
from lagsplat.diagnose.estimation.rollout import RolloutModel

Vector = Float64[np.ndarray, " d"]


class MissingAcceleration:
    """What the effects of a diagnosis add to the acceleration of the simulator at any state.

    It compares the simulator with and without its effects over one step from the same state. Effects with a
    memory begin anew at every call, and those at instants of the recording act as at its start.
    """

    def __init__(self, simulator: AugmentedSimulator) -> None:
        n = sum(len(placed.effect.parameters) for placed in simulator.effects)
        self.augmented, self.plain = simulator, replace(simulator, effects=(), x=simulator.x[n:])

    def acceleration(self, q: Vector, v: Vector, u: Float64[np.ndarray, " n_u"]) -> Vector:
        """The missing acceleration [1/s^2] at a state and its velocity under held inputs.

        Raises:
            ValueError: numbers of coordinates or inputs that are not those of the simulator.
        """
        step_s = self.augmented.step_s
        signals = AppliedSignals(np.array([0.0, step_s]), np.stack([u, u]))
        with_effects, without = (
            simulate_augmented(simulator, signals, q=q, v=v)[1][1]
            for simulator in (self.augmented, self.plain)
        )
        return (with_effects - without) / step_s


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

    Args:
        simulator: The augmented simulator.
        signals: Instants with inputs and pushes.
        q: Initial coordinates, by default the rest of the simulator.
        v: Initial velocities, by default zero.
        held: Whether inputs are held between samples, by default as in the simulator.

    Raises:
        ValueError: another number of inputs, pushes or coordinates than the simulator's, less than two
            instants, or times that do not increase.
    """
    d, n = simulator.model.d, len(signals.time_s)
    at = [simulator.model.rest if q is None else q, np.zeros(d) if v is None else v]
    if signals.u.shape != (n, simulator.model.n_u):
        raise ValueError(
            f"{signals.u.shape[1]} input column(s), but the sim has {simulator.model.n_u}: "
            + ", ".join(simulator.u_names)
        )
    if signals.push is not None and signals.push.shape != (n, d):
        raise ValueError(f"{signals.push.shape[1]} column(s) of pushes f, but the sim has {d} coordinate(s)")
    if any(len(x) != d for x in at):
        raise ValueError(
            f"the initial state has {len(at[0])} + {len(at[1])} numbers, where {d} + {d} are wanted"
        )
    if n < 2 or not (np.diff(signals.time_s) > 0.0).all():
        raise ValueError("give at least two instants, with times that increase")
    u = signals.u
    if signals.push is not None:
        simulator, u = _add_push_inputs(simulator), np.concatenate([u, signals.push], axis=1)
    dataset = Dataset(
        time=np.ascontiguousarray(signals.time_s, dtype=np.float64),
        q=np.repeat(at[0][None], n, axis=0),
        v=np.repeat(at[1][None], n, axis=0),
        u=u,
        clips=np.array([[0, n]]),
        files=("",),
        file_of=np.zeros(1, dtype=np.int64),
        shifts_s=(0.0,),
    )
    steps = max(1, int(np.ceil(np.diff(signals.time_s).max() / simulator.step_s - 1e-9)))
    held = simulator.held if held is None else held
    rollout_model = RolloutModel(simulator.model, dataset, simulator.nuisance, steps, held, dataset.q)
    start = np.concatenate(at)[None, None]
    window = WindowSet(np.zeros(1, dtype=np.int64), np.array([n]))
    y, rate = rollout_model.roll_out(simulator.effects, simulator.x[None], start, window)
    return y[0, 0], rate[0, 0]


def _add_push_inputs(simulator: AugmentedSimulator) -> AugmentedSimulator:
    """The same with one more input for each coordinate, a force that no effect and no uncertainty changes."""
    model, nuisance, d = simulator.model, simulator.nuisance, simulator.model.d
    n_u, rows = model.n_u, max(len(model.input_map), 1)
    input_map = np.zeros((rows, n_u + d, d))
    input_map[: len(model.input_map), :n_u] = model.input_map
    input_map[0, n_u:] = np.diag(np.diag(model.inertia))
    moves, n = [], len(nuisance.directions)
    at = 0
    for name in CoefficientBatch.__dataclass_fields__:
        value = getattr(model, name)
        part = nuisance.directions[:, at : at + value.size].reshape(n, *value.shape)
        at += value.size
        if name == "input_map":
            whole = np.zeros((n, *input_map.shape))
            whole[:, : len(model.input_map), :n_u] = part
            part = whole
        moves.append(part.reshape(n, int(np.prod(part.shape[1:]))))
    effects, unknowns = [], []
    at = 0
    for placed in simulator.effects:
        size = len(placed.effect.parameters)
        for copy in _split_by_channel(placed, n_u):
            effects.append(copy)
            unknowns.append(simulator.x[at : at + size])
        at += size
    x = [*unknowns, simulator.x[at : at + 2 + n_u], np.zeros(d), simulator.x[at + 2 + n_u :]]
    return replace(
        simulator,
        model=replace(model, input_map=input_map),
        nuisance=replace(nuisance, n_u=n_u + d, directions=np.concatenate(moves, axis=1)),
        effects=tuple(effects),
        x=np.concatenate(x),
    )


def _split_by_channel(placed: PlacedEffect, n_u: int) -> list[PlacedEffect]:
    """An effect of all inputs at once as one of each, so that it leaves the inputs of pushes alone."""
    if isinstance(placed.effect, InputEffect) and placed.channel is None:
        return [replace(placed, channel=channel) for channel in range(n_u)]
    return [placed]
