"""A run that is being pushed: its state, what acts on it, and what is told of both. It knows of no browser.

One thread owns a session and calls it; what a picture needs leaves it as a `Snapshot`, which never changes.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.forces.config import ForcesConfig
from lagsplat.forces.equilibrium import OperatingPoint, fit_energy_scale, settle
from lagsplat.forces.grasp import Place, Point
from lagsplat.forces.loaded_lagrangian import make_fast_lagrangian
from lagsplat.stage2.lagrangian import UNTOUCHED, LawEdits
from lagsplat.viewer.config import ViewerConfig
from lagsplat.viewer.simulation.grasp import EnergyBalance, EnergyTerms, Grasp, GraspModel
from lagsplat.viewer.simulation.history import HistoryBuffer, RecordedData, SessionHistory, measure_coverage

Status = Literal["running", "paused", "stopped"]
DIVERGED = (
    "The motion diverged and the integration stopped: nothing like this was ever recorded. Reset to rest, "
    "or undo the edits of damping, inertia and stiffness."
)
BEYOND = "Beyond the recording: the camera never saw such a state, and picture and forces are a guess."


@dataclass(frozen=True)
class Snapshot:
    """A session at one instant; states are whitened, places in pixels of the training resolution.

    ``force`` [energy of the law per px] is None where nothing is held, ``asked_s`` when the latest push that
    counts in here was asked for, on the clock of whoever asked.
    """

    time_s: float
    q: Float64[np.ndarray, " d"]
    v: Float64[np.ndarray, " d"]
    u: Float64[np.ndarray, " n_u"]
    frame: int | None
    hand: Grasp | None
    energy: EnergyTerms
    covered: float
    status: Status
    edits: LawEdits
    asked_s: float | None

    @property
    def banner(self) -> str:
        """What must be said of this state, or nothing."""
        if self.status == "stopped":
            return DIVERGED
        return BEYOND if self.covered > 1.0 else ""


class Session:
    """A run held at an operating point, pushed and edited step by step.

    Begins at rest under the mean inputs of the training part, running.
    """

    def __init__(
        self, held: OperatingPoint, recorded: RecordedData, config: ViewerConfig, forces: ForcesConfig
    ) -> None:
        self.held, self.recorded, self.config, self.forces = held, recorded, config, forces
        width = held.kinematics.width
        self.dt_s = held.chart.dt_s
        self.touch = GraspModel(
            held, radius_px=forces.brush * width, drag_px=config.reach * width, response=forces.response
        )
        self.coverage = measure_coverage(held.chart, beyond=config.beyond)
        self.edits, self.law = UNTOUCHED, make_fast_lagrangian(held.law)
        self.u = held.u.numpy().copy()
        self.q, self.v = held.rest.numpy().copy(), np.zeros(held.law.d)
        self.tape = HistoryBuffer(
            d=held.law.d, n_u=len(self.u), space=held.kinematics.space, dt_s=self.dt_s,
            rows=round(config.log_s / self.dt_s),
        )  # fmt: skip
        self.ledger = EnergyBalance(self.law, self.q, self.v)
        self.status: Status = "running"
        self.hand: Grasp | None = None
        self.last_push: Grasp | None = None
        self.frame: int | None = None
        self.following = False
        self.playing: SessionHistory | None = None
        self.played, self.clip, self.steps = 0, 0, 0
        self.strength = 1.0
        self.kappa: float | None = None
        self.asked_s: float | None = None

    def grasp(self, at: Point | Place, *, met: int | None = None, asked_s: float | None = None) -> Grasp:
        """Take hold of the matter at ``at`` [px], and in space of the Gaussian ``met`` there.

        Raises:
            ValueError: there is nothing, or the point is outside the picture.
        """
        self.playing, self.asked_s = None, asked_s
        self.hand = self.touch.grasp(self.q, at, met=met)
        return self.hand

    def pull(self, drag_px: Float64[np.ndarray, " n"], *, asked_s: float | None = None) -> None:
        """Hold the grasped matter with the force of a drag (right, down and, in space, ahead), until the next
        one or `release`.

        The force is `strength` times `GraspModel.gain` times the drag, and does not follow the matter. Without a
        grasp nothing happens.

        Raises:
            ValueError: a drag that is not finite.
        """
        if not np.isfinite(drag_px).all():
            raise ValueError(f"a drag of {drag_px.tolist()} px is not finite; nothing was pushed")
        if self.hand is not None:
            self.hand = replace(self.hand, force=self.strength * self.touch.gain * drag_px)
            self.last_push, self.asked_s = self.hand, asked_s

    def release(self, *, asked_s: float | None = None) -> None:
        """Let go."""
        self.hand, self.asked_s = None, asked_s

    def pause(self, on: bool) -> None:
        """Stand still between two steps, or go on; a motion that diverged needs a reset first."""
        if self.status != "stopped":
            self.status = "paused" if on else "running"

    def edit(self, **factors: float) -> None:
        """Change factors of ``damping``, ``inertia`` and ``stiffness``; others stay.

        Raises:
            ValueError: a factor that `LawEdits` refuses.
        """
        self._take(replace(self.edits, **factors))

    def set_inputs(self, u: Float64[np.ndarray, " n_u"]) -> None:
        """Hold these inputs from now on, instead of the recorded ones.

        Raises:
            ValueError: another number of inputs, or one that is not finite.
        """
        if u.shape != self.u.shape or not np.isfinite(u).all():
            raise ValueError(f"inputs {u.tolist()}: give {len(self.u)} finite numbers")
        self.u, self.following = u.astype(np.float64), False

    def follow(self, on: bool) -> None:
        """Replay the recorded inputs from the present frame on, or hold what they are now."""
        self.following = on
        if on and self.frame is None:
            self.frame = self.recorded.segments[0][0]

    def to_rest(self) -> None:
        """Stand still where the law settles under the present inputs.

        Raises:
            NotSettledError: it settles nowhere within the numbers.
        """
        rest = settle(
            self.held.law, torch.from_numpy(self.u)[None], torch.zeros(1, self.held.law.d).double(),
            edits=self.edits, start=self.held.rest,
        )[0].numpy()  # fmt: skip
        self._begin(rest, np.zeros(self.held.law.d), None)

    def to_frame(self, frame: int) -> None:
        """The recorded state, velocity and inputs of a frame.

        Raises:
            ValueError: the recording has no such frame.
        """
        frame = self.recorded.require(frame)
        self.u = self.recorded.u[frame].copy()
        self._begin(self.recorded.q[frame].copy(), self.recorded.v[frame].copy(), frame)

    def replay(self, taped: SessionHistory) -> None:
        """Do again what was taped: from its first state, with its forces, inputs and edits.

        Raises:
            ValueError: it is of another run: other numbers of coordinates, inputs or dimensions, or another
                rate.
        """
        sizes = (taped.q.shape[1], taped.u.shape[1], taped.force.shape[1])
        same = sizes == (self.held.law.d, len(self.u), self.held.kinematics.space)
        if not same or abs(taped.dt_s / self.dt_s - 1.0) > 1e-6:
            raise ValueError(
                f"the session has {sizes[0]} coordinates, {sizes[1]} inputs, forces in {sizes[2]} dimensions "
                f"and steps of {taped.dt_s:.6g} s, this run {self.held.law.d}, {len(self.u)}, "
                f"{self.held.kinematics.space} and {self.dt_s:.6g} s; open the run that it was made with"
            )
        self.playing, self.played = taped, 0
        self.status = "running"

    def calibrate(self, *, force: float, moved_px: float) -> float:
        """Set ``kappa``: a ``force`` in your unit, held as the last push was, moves its matter ``moved_px``.

        ``kappa`` is energy of the law per unit of force and pixel: a force in your unit times kappa is one of
        the law. Both lie along the last push.

        Raises:
            ValueError: nothing was pushed yet, or numbers that are not positive.
            NoScaleError: no factor makes the law answer so.
        """
        if self.last_push is None or not np.linalg.norm(self.last_push.force) > 0:
            raise ValueError("push the object once, where and as you pushed the real one, and calibrate then")
        if not (np.isfinite([force, moved_px]).all() and force > 0 and moved_px > 0):
            raise ValueError(f"a force of {force} and a way of {moved_px} px: both must be positive numbers")
        along = self.last_push.force / np.linalg.norm(self.last_push.force)
        jacobian = self.last_push.grip.jacobian.numpy()
        self.kappa = fit_energy_scale(
            self.held, force * along @ jacobian, jacobian[None], moved_px * along[None]
        )
        return self.kappa

    def step(self) -> None:
        """One step of the recording's rate, paused or not; none once the motion diverged."""
        if self.status == "stopped":
            return
        load = self._drive()
        before = (self.q, self.v)
        self._note(load)
        with np.errstate(all="ignore"):
            q, v = self.law.step(self.q, self.v, self.u, load, dt_s=self.dt_s)
        away = float(np.linalg.norm(q - self.held.rest.numpy()))
        if not (np.isfinite(v).all() and away <= self.config.divergence * self.held.reach):
            self.halt()
            return
        self.q, self.v = q, v
        self.steps += 1
        self.ledger.book(self.law, before, (q, v), self.u, load, dt_s=self.dt_s)

    def halt(self) -> None:
        """Stop where it stands, until the state is set anew."""
        self.status, self.hand, self.playing = "stopped", None, None

    def snapshot(self) -> Snapshot:
        """The session as it stands."""
        return Snapshot(
            self.steps * self.dt_s, self.q, self.v, self.u, self.frame, self.hand, self.ledger.told(),
            self.coverage.distance(self.q), self.status, self.edits, self.asked_s,
        )  # fmt: skip

    def _drive(self) -> Float64[np.ndarray, " d"]:
        """Advance what acts from outside; returns the generalised force of this step."""
        if self.playing is not None:
            return self._played()
        if self.frame is not None:
            self.u = self.recorded.u[self.frame].copy() if self.following else self.u
            self.frame = self.recorded.after(self.frame)
        return np.zeros(self.held.law.d) if self.hand is None else self.hand.load

    def _played(self) -> Float64[np.ndarray, " d"]:
        taped, row = self.playing, self.played
        assert taped is not None
        if row == 0 or taped.clip[row] != taped.clip[row - 1]:
            self._begin(taped.q[row].copy(), taped.v[row].copy(), None)
        if taped.edits_at(row) != self.edits:
            self._take(taped.edits_at(row))
        self.u, self.played = taped.u[row].copy(), row + 1
        if self.played == len(taped):
            self.playing = None
        return taped.load[row]

    def _begin(self, q: np.ndarray, v: np.ndarray, frame: int | None) -> None:
        self.q, self.v, self.frame, self.hand = q, v, frame, None
        self.clip += 1
        self.ledger.open(self.law, q, v)
        self.status = "running" if self.status == "stopped" else self.status

    def _take(self, edits: LawEdits) -> None:
        self.edits, self.law = edits, make_fast_lagrangian(self.held.law, edits=edits)
        self.ledger.edit(self.law, self.q, self.v)

    def _note(self, load: Float64[np.ndarray, " d"]) -> None:
        energy = self.ledger.told()
        held = self.hand
        self.tape.add(
            self.clip, self.q, self.v, self.u, load,
            np.zeros(self.tape.space) if held is None else held.force,
            np.full(self.tape.space, np.nan) if held is None else held.place(self.q),
            np.array([self.edits.damping, self.edits.inertia, self.edits.stiffness]),
            np.array([energy.kinetic, energy.potential, energy.hand, energy.inputs, energy.dissipated]),
        )  # fmt: skip
