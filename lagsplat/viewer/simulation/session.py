"""The interactive session of a fitted run: its state, the forces and edits that act on it, and its history.

One thread owns a session. Other threads read it through a `Snapshot`, which never changes.
"""

from dataclasses import dataclass, replace
from typing import Literal

import numpy as np
import torch
from jaxtyping import Float64

from lagsplat.array_types import Vector
from lagsplat.forces.config import ForcesConfig
from lagsplat.forces.grasp import Place, Point
from lagsplat.forces.loaded_lagrangian import find_loaded_equilibria, make_fast_lagrangian
from lagsplat.forces.loads import PointLoad
from lagsplat.forces.operating_point import OperatingPoint, fit_energy_scale
from lagsplat.stage2.lagrangian import UNTOUCHED, LawEdits
from lagsplat.viewer.config import ViewerConfig
from lagsplat.viewer.simulation.grasp import EnergyBalance, Grasp, GraspModel
from lagsplat.viewer.simulation.history import HistoryBuffer, RecordedData, SessionHistory, measure_coverage

Status = Literal["running", "paused", "stopped"]
DIVERGED = (
    "The motion diverged and the integration stopped: nothing like this was ever recorded. Reset to rest, "
    "or undo the edits of damping, inertia and stiffness."
)
BEYOND = "Beyond the recording: the camera never saw such a state, and image and forces are a guess."
UNDETERMINED = "Not determined by this recording: laws that fit it as well take this point elsewhere."


RANGE_ROWS = 400  # recorded states of which the range of the energy is taken


@dataclass(frozen=True)
class Snapshot:
    """A session at one instant; states are whitened, positions in pixels of the training resolution.

    ``requested_s`` is the time at which the latest drag that acts here was requested, on the clock of the
    caller.
    """

    time_s: float
    q: Vector
    v: Vector
    u: Float64[np.ndarray, " n_u"]
    frame: int | None
    active_grasp: Grasp | None
    energy: EnergyBalance
    coverage_distance: float
    status: Status
    edits: LawEdits
    requested_s: float | None

    @property
    def is_beyond(self) -> bool:
        """Whether the recording never was near this state."""
        return self.status != "stopped" and self.coverage_distance > 1.0

    @property
    def banner(self) -> str:
        """Warning to show with this state, or an empty string."""
        if self.status == "stopped":
            return DIVERGED
        if self.is_beyond:
            return BEYOND
        return UNDETERMINED if self.active_grasp is not None and self.active_grasp.is_undetermined else ""


class Session:
    """Steps a run that a user pushes and edits; starts at rest under the inputs of the operating point."""

    def __init__(
        self,
        point: OperatingPoint,
        recorded: RecordedData,
        config: ViewerConfig,
        forces: ForcesConfig,
        draws: Float64[np.ndarray, "m p"] | None = None,
    ) -> None:
        self.operating_point, self.recorded = point, recorded
        self.config, self.forces = config, forces
        self.dt_s = point.chart.dt_s
        self.grasp_model = GraspModel(point, forces, draws)
        self.coverage = measure_coverage(point.chart, beyond=config.beyond)
        self.edits, self.law = UNTOUCHED, make_fast_lagrangian(point.law)
        self.u = point.u.numpy().copy()
        self.q, self.v = point.rest.numpy().copy(), np.zeros(point.law.d)
        self.history = HistoryBuffer(dt_s=self.dt_s, rows=round(config.log_s / self.dt_s))
        self.energy = EnergyBalance.begin(self.law, self.q, self.v)
        self.status: Status = "running"
        self.active_grasp: Grasp | None = None
        self.last_push: Grasp | None = None
        self.frame: int | None = None
        self.following = False
        self.replaying: SessionHistory | None = None
        self.replay_row, self.clip, self.steps = 0, 0, 0
        self.strength = 1.0
        self.kappa: float | None = None
        self.requested_s: float | None = None

    def grasp(self, at: Point | Place, *, requested_s: float | None = None) -> Grasp:
        """Grasp the matter at ``at`` [px], or the background where there is none.

        Raises:
            ValueError: the point is outside the image or not finite.
        """
        self.replaying, self.requested_s = None, requested_s
        self.active_grasp = self.grasp_model.grasp(self.q, at)
        return self.active_grasp

    def pull(self, drag_px: Float64[np.ndarray, " n"], *, requested_s: float | None = None) -> None:
        """Apply the force of a drag (right, down and, in space, ahead) until the next one or `release`.

        The force is ``strength`` times that of `Grasp.pulled`. It keeps size and direction while the matter
        moves; its generalised force is that of the state at the start of each step. Without a grasp nothing
        happens.

        Raises:
            ValueError: a drag that is not finite.
        """
        if not np.isfinite(drag_px).all():
            raise ValueError(f"a drag of {drag_px.tolist()} px is not finite; nothing was pushed")
        if self.active_grasp is not None:
            self.active_grasp = self.active_grasp.pulled(drag_px, strength=self.strength)
            self.last_push, self.requested_s = self.active_grasp, requested_s

    def release(self, *, requested_s: float | None = None) -> None:
        """End the grasp and its force."""
        self.active_grasp, self.requested_s = None, requested_s

    def pause(self, on: bool) -> None:
        """Pause or continue; a motion that diverged needs a reset first."""
        if self.status != "stopped":
            self.status = "paused" if on else "running"

    def edit(self, **factors: float) -> None:
        """Change the factors of ``damping``, ``inertia`` or ``stiffness`` that are given.

        Raises:
            ValueError: a factor that `LawEdits` refuses.
        """
        self._apply_edits(replace(self.edits, **factors))

    def set_inputs(self, u: Float64[np.ndarray, " n_u"]) -> None:
        """Apply these constant inputs instead of the recorded ones.

        Raises:
            ValueError: another number of inputs, or one that is not finite.
        """
        if u.shape != self.u.shape or not np.isfinite(u).all():
            raise ValueError(f"inputs {u.tolist()}: give {len(self.u)} finite numbers")
        self.u, self.following = u.astype(np.float64), False

    def follow(self, on: bool) -> None:
        """Replay the recorded inputs from the present frame on, or keep the present inputs constant."""
        self.following = on
        if on and self.frame is None:
            self.frame = self.recorded.segments[0][0]

    def to_rest(self) -> None:
        """Reset to the equilibrium under the present inputs.

        Raises:
            ValueError: no equilibrium was found.
        """
        law, start = self.operating_point.law, self.operating_point.rest
        u = torch.from_numpy(self.u)[None]
        rest = find_loaded_equilibria(law, u, edits=self.edits, start=start)[0].numpy()
        self._reset(rest, np.zeros(law.d), None)

    def to_frame(self, frame: int) -> None:
        """Reset to the recorded state, velocity and inputs of a frame.

        Raises:
            ValueError: the recording has no such frame.
        """
        recorded, last = self.recorded, len(self.recorded.q) - 1
        if not any(a <= frame < b for a, b in recorded.segments):
            raise ValueError(f"frame {frame} is none of the recording, which has the frames 0 to {last}")
        self.u = recorded.u[frame].copy()
        self._reset(recorded.q[frame].copy(), recorded.v[frame].copy(), frame)

    def begin_in_motion(self) -> None:
        """Go on in a recorded state: driven runs as recorded, others where it is farthest from rest."""
        self.following = len(self.u) > 0
        away = np.linalg.norm(self.recorded.q - self.operating_point.rest.numpy(), axis=1)
        self.to_frame(self.recorded.segments[0][0] if self.following else int(away.argmax()))

    def measure_ranges(self) -> tuple[float, float]:
        """Ranges of the state and of the energy in the recording."""
        recorded, law = self.recorded, make_fast_lagrangian(self.operating_point.law)
        rows = np.unique(np.linspace(0, len(recorded.q) - 1, RANGE_ROWS).astype(int))
        pairs = zip(recorded.q[rows], recorded.v[rows], strict=True)
        energies = [float(law.kinetic(q, v)) + float(law.potential(q)) for q, v in pairs]
        return float(np.ptp(recorded.q)), float(np.ptp(energies))

    def replay(self, history: SessionHistory) -> None:
        """Repeat a history: from its first state, with its forces, inputs and edits.

        Raises:
            ValueError: it belongs to another run: other numbers of coordinates, inputs or dimensions, or
                another rate.
        """
        point = self.operating_point
        sizes = (history.q.shape[1], history.u.shape[1], history.force.shape[1])
        same = sizes == (point.law.d, len(self.u), point.matter.space)
        if not same or abs(history.dt_s / self.dt_s - 1.0) > 1e-6:
            raise ValueError(
                f"the session has {sizes[0]} coordinates, {sizes[1]} inputs, forces in {sizes[2]} dimensions "
                f"and steps of {history.dt_s:.6g} s, this run {point.law.d}, {len(self.u)}, "
                f"{point.matter.space} and {self.dt_s:.6g} s; open the run that it was made with"
            )
        self.replaying, self.replay_row = history, 0
        self.status = "running"

    def calibrate(self, *, force: float, moved_px: float) -> float:
        """Set the energy scale ``kappa`` from one measured push and return it.

        A ``force`` in the user's unit, applied like the last push, moved the matter by ``moved_px`` along it.
        ``kappa`` [energy of the law per unit of force and pixel] turns such a force into one of the law.

        Raises:
            ValueError: nothing was pushed yet, or numbers that are not positive.
            NoScaleError: no factor makes the law answer so.
        """
        if self.last_push is None or not np.linalg.norm(self.last_push.force) > 0:
            raise ValueError("push the object once, where and as you pushed the real one, and calibrate then")
        if not (np.isfinite([force, moved_px]).all() and force > 0 and moved_px > 0):
            raise ValueError(f"force={force} and moved_px={moved_px}: both must be positive numbers")
        along, points = self.last_push.force[None], self.last_push.grasp_point.points
        along = along / np.linalg.norm(along)
        push = PointLoad(points, torch.from_numpy(force * along))
        self.kappa = fit_energy_scale(self.operating_point, push, points, moved_px * along)
        return self.kappa

    def step(self) -> None:
        """Advance by one frame of the recording, paused or not; do nothing once the motion diverged."""
        if self.status == "stopped":
            return
        load = self._advance_inputs()
        before = (self.q, self.v)
        self._record_row(load)
        with np.errstate(all="ignore"):
            q, v = self.law.step(self.q, self.v, self.u, load, dt_s=self.dt_s)
        away = float(np.linalg.norm(q - self.operating_point.rest.numpy()))
        farthest = self.config.divergence * self.operating_point.visited_radius
        if not (np.isfinite(v).all() and away <= farthest):
            self.stop()
            return
        self.q, self.v = q, v
        self.steps += 1
        self.energy = self.energy.after_step(self.law, before, (q, v), self.u, load, dt_s=self.dt_s)

    def stop(self) -> None:
        """Stop stepping until the next reset."""
        self.status, self.active_grasp, self.replaying = "stopped", None, None

    def snapshot(self) -> Snapshot:
        """The present state of the session."""
        return Snapshot(
            self.steps * self.dt_s,
            self.q,
            self.v,
            self.u,
            self.frame,
            self.active_grasp,
            self.energy,
            self.coverage.distance(self.q),
            self.status,
            self.edits,
            self.requested_s,
        )

    def _advance_inputs(self) -> Vector:
        """Advance the inputs by one frame; return the generalised force of this step."""
        if self.replaying is not None:
            return self._replay_step()
        if self.frame is not None:
            self.u = self.recorded.u[self.frame].copy() if self.following else self.u
            self.frame = self.recorded.next_frame(self.frame)
        grasp = self.active_grasp
        return np.zeros(self.operating_point.law.d) if grasp is None else grasp.load(self.q)

    def _replay_step(self) -> Vector:
        history, row = self.replaying, self.replay_row
        assert history is not None
        if row == 0 or history.clip[row] != history.clip[row - 1]:
            self._reset(history.q[row].copy(), history.v[row].copy(), None)
        if history.edits_at(row) != self.edits:
            self._apply_edits(history.edits_at(row))
        self.u, self.replay_row = history.u[row].copy(), row + 1
        if self.replay_row == len(history):
            self.replaying = None
        return history.load[row]

    def _reset(self, q: np.ndarray, v: np.ndarray, frame: int | None) -> None:
        self.q, self.v, self.frame, self.active_grasp = q, v, frame, None
        self.clip += 1
        self.energy = EnergyBalance.begin(self.law, q, v)
        self.status = "running" if self.status == "stopped" else self.status

    def _apply_edits(self, edits: LawEdits) -> None:
        self.edits, self.law = edits, make_fast_lagrangian(self.operating_point.law, edits=edits)
        self.energy = self.energy.after_edit(self.law, self.q, self.v)

    def _record_row(self, load: Vector) -> None:
        energy, edits, grasp = self.energy, self.edits, self.active_grasp
        space = self.operating_point.matter.space
        force = np.zeros(space) if grasp is None else grasp.force
        place = np.full(space, np.nan) if grasp is None else grasp.place(self.q)
        factors = np.array([edits.damping, edits.inertia, edits.stiffness])
        flows = [energy.hand_work, energy.input_work, energy.dissipated]
        energies = np.array([energy.kinetic, energy.potential, *flows])
        self.history.add(self.clip, self.q, self.v, self.u, load, force, place, factors, energies)
