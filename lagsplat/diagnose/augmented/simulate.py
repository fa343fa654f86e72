"""The acceleration that a diagnosis found missing, at any state: what its effects add to the sim.

An augmented sim under inputs and pushes of one's own, from a state of one's own.
"""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.augmented.model import AugmentedSimulator
from lagsplat.diagnose.effects.base import CoefficientBatch, InputEffect, PlacedEffect
from lagsplat.diagnose.estimation.dataset import Dataset, WindowSet
from lagsplat.diagnose.estimation.rollout import RolloutModel

Vector = Float64[np.ndarray, " d"]


class MissingAcceleration:
    """Compares a sim with and without its diagnosed effects over one step, from the same state.

    Effects with a memory begin anew at every call, and those at instants of the recording act as at its
    start.
    """

    def __init__(self, one: AugmentedSimulator) -> None:
        own = sum(len(effect.effect.parameters) for effect in one.effects)
        self.whole, self.plain = one, replace(one, effects=(), x=one.x[own:])

    def acceleration(self, q: Vector, v: Vector, u: Float64[np.ndarray, " n_u"]) -> Vector:
        """What is missing at a state and its velocity under held inputs [1/s^2].

        Raises:
            ValueError: numbers of coordinates or inputs that are not the sim's.
        """
        step_s = self.whole.step_s
        drive = AppliedSignals(np.array([0.0, step_s]), np.stack([u, u]))
        with_effects, without = (
            simulate_augmented(one, drive, q=q, v=v)[1][1] for one in (self.whole, self.plain)
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
    one: AugmentedSimulator,
    drive: AppliedSignals,
    *,
    q: Float64[np.ndarray, " d"] | None = None,
    v: Float64[np.ndarray, " d"] | None = None,
    held: bool | None = None,
) -> tuple[Float64[np.ndarray, "N d"], Float64[np.ndarray, "N d"]]:
    """What is seen of the coordinates at the instants of ``drive``, and their rates.

    From ``q``, by default the rest of the sim, and ``v``, by default none. ``held`` overrides whether inputs
    are held between samples.

    Raises:
        ValueError: another number of inputs, pushes or coordinates than the sim's, less than two instants, or
        times that do not increase.
    """
    d, n = one.model.d, len(drive.time_s)
    at = [one.model.rest if q is None else q, np.zeros(d) if v is None else v]
    if drive.u.shape != (n, one.model.n_u):
        raise ValueError(
            f"{drive.u.shape[1]} input column(s), but the sim has {one.model.n_u}: {', '.join(one.u_names)}"
        )
    if drive.push is not None and drive.push.shape != (n, d):
        raise ValueError(f"{drive.push.shape[1]} column(s) of pushes f, but the sim has {d} coordinate(s)")
    if any(len(x) != d for x in at):
        raise ValueError(
            f"the initial state has {len(at[0])} + {len(at[1])} numbers, where {d} + {d} are wanted"
        )
    if n < 2 or not (np.diff(drive.time_s) > 0.0).all():
        raise ValueError("give at least two instants, with times that increase")
    u = drive.u
    if drive.push is not None:
        one, u = _pushable(one), np.concatenate([u, drive.push], axis=1)
    record = Dataset(
        time=np.ascontiguousarray(drive.time_s, dtype=np.float64),
        q=np.repeat(at[0][None], n, axis=0),
        v=np.repeat(at[1][None], n, axis=0),
        u=u,
        clips=np.array([[0, n]]),
        files=("",),
        file_of=np.zeros(1, dtype=np.int64),
        shifts_s=(0.0,),
    )
    steps = max(1, int(np.ceil(np.diff(drive.time_s).max() / one.step_s - 1e-9)))
    bench = RolloutModel(one.model, record, one.nuisance, steps, one.held if held is None else held, record.q)
    start = np.concatenate(at)[None, None]
    whole = WindowSet(np.zeros(1, dtype=np.int64), np.array([n]))
    seen, rate = bench.roll_out(one.effects, one.x[None], start, whole)
    return seen[0, 0], rate[0, 0]


def _pushable(one: AugmentedSimulator) -> AugmentedSimulator:
    """The same with an input for the force along every coordinate, which no effect and no doubt touches."""
    model, spare, d = one.model, one.nuisance, one.model.d
    n_u, rows = model.n_u, max(len(model.input_map), 1)
    reach = np.zeros((rows, n_u + d, d))
    reach[: len(model.input_map), :n_u] = model.input_map
    reach[0, n_u:] = np.diag(np.diag(model.inertia))
    moves, n = [], len(spare.directions)
    at = 0
    for name in CoefficientBatch.__dataclass_fields__:
        value = getattr(model, name)
        part = spare.directions[:, at : at + value.size].reshape(n, *value.shape)
        at += value.size
        if name == "input_map":
            whole = np.zeros((n, *reach.shape))
            whole[:, : len(model.input_map), :n_u] = part
            part = whole
        moves.append(part.reshape(n, int(np.prod(part.shape[1:]))))
    effects, own = [], []
    at = 0
    for effect in one.effects:
        size = len(effect.effect.parameters)
        for copy in _by_channel(effect, n_u):
            effects.append(copy)
            own.append(one.x[at : at + size])
        at += size
    wider = [*own, one.x[at : at + 2 + n_u], np.zeros(d), one.x[at + 2 + n_u :]]
    return replace(
        one,
        model=replace(model, input_map=reach),
        nuisance=replace(spare, n_u=n_u + d, directions=np.concatenate(moves, axis=1)),
        effects=tuple(effects),
        x=np.concatenate(wider),
    )


def _by_channel(effect: PlacedEffect, n_u: int) -> list[PlacedEffect]:
    """An effect of all inputs at once as one of each: pushes do not come over the wire."""
    if isinstance(effect.effect, InputEffect) and effect.channel is None:
        return [replace(effect, channel=channel) for channel in range(n_u)]
    return [effect]
