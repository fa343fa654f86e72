"""Rollouts of a model over the windows of a dataset, from parameters to what would be measured."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
from jaxtyping import Float64, Int64

from lagsplat.diagnose.effects.base import (
    CoefficientBatch,
    Direction,
    ForceEffect,
    InputEffect,
    ModelEffect,
    ObservationEffect,
    PlacedEffect,
)
from lagsplat.diagnose.estimation.dataset import Dataset, WindowSet
from lagsplat.diagnose.estimation.input_signals import InputSignal, build_input_signals
from lagsplat.diagnose.estimation.nuisance import NuisanceParameters
from lagsplat.diagnose.mechanics.model import MechanicalModel
from lagsplat.diagnose.mechanics.structure import COEFFICIENT_FIELDS
from lagsplat.diagnose.solvers.dry_friction import (
    PRESLIDING_SHARE,
    integrate_presliding,
    resist_evenly,
)
from lagsplat.diagnose.solvers.force_laws import integrate_memory
from lagsplat.diagnose.solvers.runge_kutta import roll_out_batch

Placed = Sequence[tuple[PlacedEffect, np.ndarray]]
"""Effects, each with its parameters (P, k) in the units of the recording."""


ROLLED_FIELDS = tuple(name for name in COEFFICIENT_FIELDS if name != "dry")  # dry friction is a force law


@dataclass(frozen=True)
class ForceSlot:
    """A force that is added to the model, for ``P`` sets of parameters."""

    law: int  # address of the compiled law
    acts: Direction
    sees: Float64[np.ndarray, " d"]
    theta: Float64[np.ndarray, "P n"]
    memory: Float64[np.ndarray, "P N Z"]  # at every frame, along the recorded motion
    bristles: int = -1  # place of the presliding displacement among the parameters of dry friction


@dataclass(frozen=True)
class RolloutModel:
    """Rolls out hypotheses about a dataset: the model, its nuisance parameters and any effects."""

    model: MechanicalModel
    dataset: Dataset
    nuisance: NuisanceParameters
    steps: int  # substeps of a rollout between two frames
    held: bool  # inputs are held between samples (zero-order hold) instead of interpolated
    payload: float = 0.0  # known inertia that is added to the mechanism, as a share of that at rest [1]

    @cached_property
    def inputs(self) -> tuple[InputSignal, ...]:
        """The logged inputs, one signal a channel."""
        return build_input_signals(self.dataset, steps=self.steps, held=self.held)

    @cached_property
    def stages(self) -> tuple[int, int, int]:
        """Shape of a signal: frames, substeps, stages."""
        return (len(self.dataset.time), self.steps, 3)

    @cached_property
    def logged(self) -> Float64[np.ndarray, "1 N S 3 n_u"]:
        """The logged inputs at every stage of a rollout, as the kernel takes them."""
        logged = np.empty((1, *self.stages, len(self.inputs)))
        for channel, signal in enumerate(self.inputs):
            logged[0, ..., channel] = signal.to_stages(signal.values[None]).reshape(self.stages)
        return logged

    @cached_property
    def forces(self) -> tuple[np.ndarray, np.ndarray]:
        """The model's conservative and actuated forces (N, d) along the recorded motion."""
        return self.model.spring(self.dataset.smooth), self.model.drive(self.dataset.smooth, self.dataset.u)

    def roll_out(
        self,
        effects: Sequence[PlacedEffect],
        x: Float64[np.ndarray, "P k"],
        starts: Float64[np.ndarray, "P W s"],
        windows: WindowSet,
    ) -> tuple[np.ndarray, np.ndarray]:
        """Measured coordinates and their rates, (P, W, L, d) each, from the initial states ``starts``.

        ``x`` are the unknowns of the effects, one after another, then the nuisance parameters.
        """
        placed, at = [], 0
        for part in (part for effect in effects for part in effect.parts or (effect,)):
            size = len(part.effect.parameters)
            placed.append((part, part.to_physical(x[:, at : at + size])))
            at += size
        nuisance = x[:, at:]
        states = self._states(placed, nuisance, starts, windows)
        y, v = states[..., : self.dataset.d], states[..., self.dataset.d :]
        y = self.nuisance.observe(y, nuisance, self.model)
        t = windows.take(self.dataset.time)
        for effect, theta in placed:
            if isinstance(effect.effect, ObservationEffect):
                y = effect.effect.observe(y, v, t, theta, effect)
        return y, v

    def _states(
        self, placed: Placed, nuisance: np.ndarray, starts: np.ndarray, windows: WindowSet
    ) -> np.ndarray:
        fields = self._fields(placed, nuisance)
        u, u_of = self._inputs(placed, len(nuisance))
        laws, geometry, theta, memory = self._laws(placed, fields, windows)
        model = self.model
        out = np.zeros((len(nuisance), len(windows.first), windows.longest, 2 * model.d))
        coefficients = (_move_functions_last(getattr(fields, name)) for name in ROLLED_FIELDS)
        roll_out_batch(
            model.basis.arrays,
            (*coefficients, model.rest),
            laws,
            geometry,
            theta,
            memory,
            np.ascontiguousarray(starts),
            windows.first,
            windows.length,
            self.dataset.time,
            u,
            u_of,
            self.steps,
            out,
        )
        return out

    def _fields(self, placed: Placed, nuisance: np.ndarray) -> CoefficientBatch:
        fields = self.nuisance.change_coefficients(self.model, nuisance)
        for effect, theta in placed:
            if isinstance(effect.effect, ModelEffect):
                fields = effect.effect.change(fields, theta, effect, self.model)
            elif isinstance(effect.effect, ForceEffect) and effect.direction is None:
                fields = effect.effect.whole(fields, theta, self.model)
        if self.payload:  # after all effects: a mass that differs is the mechanism's own
            fields.mass[:, 0] += self.payload * self.model.inertia
        return fields

    def _inputs(self, placed: Placed, n_sets: int) -> tuple[np.ndarray, np.ndarray]:
        """Distinct inputs, as `logged`, and the number of those of each set of parameters."""
        changes = [(effect, theta) for effect, theta in placed if isinstance(effect.effect, InputEffect)]
        if not changes:
            return self.logged, np.zeros(n_sets, dtype=np.int64)
        theta = np.concatenate([theta for _, theta in changes], axis=1)
        # Most sets of a finite difference have the same input parameters; each distinct signal is made once.
        distinct, u_of = np.unique(theta, axis=0, return_inverse=True)
        u = np.repeat(self.logged, len(distinct), axis=0)
        changed: dict[int, np.ndarray] = {}
        at = 0
        for effect, part in changes:
            values = distinct[:, at : at + part.shape[1]]
            at += part.shape[1]
            assert isinstance(effect.effect, InputEffect)
            for channel in effect.list_channels(u.shape[-1]):
                signal, change = self.inputs[channel], effect.effect.change_input
                if channel in changed:  # what one effect gives is what the next one gets
                    rows = zip(changed[channel], values, strict=True)
                    changed[channel] = np.stack(
                        [change(signal.with_values(row), theta[None])[0] for row, theta in rows]
                    )
                else:
                    changed[channel] = change(signal, values)
        for channel, signals in changed.items():
            stages = self.inputs[channel].to_stages(signals)
            u[..., channel] = stages.reshape(len(distinct), *self.stages)
        return u, u_of.reshape(-1).astype(np.int64)

    def _laws(
        self, placed: Placed, fields: CoefficientBatch, windows: WindowSet
    ) -> tuple[np.ndarray, tuple[np.ndarray, ...], np.ndarray, np.ndarray]:
        """Laws, geometry, parameters and memories of all slots, as the kernel takes them."""
        slots = self._rub_itself(fields)  # first, so that no effect moves its bristles
        slots += [
            self._fill_slot(effect, acts, sees, place, theta)
            for place, theta in placed
            if isinstance(effect := place.effect, ForceEffect) and place.direction is not None
            for acts, sees in place.list_slots(self.model)
        ]
        n, d, n_sets = len(slots), self.model.d, len(fields.dry)
        table = np.zeros((n_sets, n, max([1, *(slot.theta.shape[1] for slot in slots)])))
        n_memory = max([slot.memory.shape[-1] for slot in slots], default=0)
        memory = np.zeros((n_sets, len(windows.first), n, n_memory))
        for k, slot in enumerate(slots):
            table[:, k, : slot.theta.shape[1]] = slot.theta
            memory[:, :, k, : slot.memory.shape[-1]] = slot.memory[:, windows.first]
        geometry = (
            np.array([slot.acts.covector for slot in slots]).reshape(n, d),
            np.array([slot.sees for slot in slots]).reshape(n, d),
            np.array([slot.acts.inertia for slot in slots], dtype=float),
            np.array([slot.bristles for slot in slots], dtype=np.int64),
            _find_contacts(slots),
        )
        return np.array([slot.law for slot in slots], dtype=np.int64), geometry, table, memory

    def _rub_itself(self, fields: CoefficientBatch) -> list[ForceSlot]:
        """The model's own dry friction, along each coordinate that has some."""
        slots = []
        for i, covector in enumerate(np.eye(self.model.d)):
            if fields.dry[:, i].any():
                acts = Direction.of(None, covector, self.model)
                level = np.maximum(fields.dry[:, i], 0.0) / acts.inertia
                presliding = np.full(len(level), PRESLIDING_SHARE * self.model.basis.scale[i])
                theta = np.stack([level, presliding, np.ones(len(level))], axis=1)
                begin = self._presliding(acts, presliding)[..., None]
                slots.append(ForceSlot(resist_evenly.address, acts, covector, theta, begin, 1))
        return slots

    def _fill_slot(
        self, effect: ForceEffect, acts: Direction, sees: np.ndarray, place: PlacedEffect, theta: np.ndarray
    ) -> ForceSlot:
        fixed = np.array((*effect.constants(place.scales, place.variant), *place.constants))
        table = np.concatenate([theta[:, : effect.n_law], np.repeat(fixed[None], len(theta), axis=0)], axis=1)
        if place.variant in effect.dry:
            begin = self._presliding(acts, theta[:, effect.presliding])[..., None]
            return ForceSlot(effect.law.address, acts, sees, table, begin, effect.presliding)
        begin = np.zeros((len(theta), len(self.dataset.time), effect.n_memory))
        if effect.memory_start:
            begin = self._memory(effect, acts, table, theta[:, effect.n_law :])
        return ForceSlot(effect.law.address, acts, sees, table, begin)

    def _presliding(self, direction: Direction, displacement: np.ndarray) -> Float64[np.ndarray, "P N"]:
        """Share of dry friction at every frame along the smoothed motion, by presliding displacement (P,)."""
        distinct, which = np.unique(displacement, return_inverse=True)
        out = np.empty((len(distinct), len(self.dataset.time)))
        integrate_presliding(distinct, self.dataset.smooth @ direction.covector, self.dataset.clips, out)
        return out[which]

    def _memory(
        self, effect: ForceEffect, direction: Direction, theta: np.ndarray, initial: np.ndarray
    ) -> Float64[np.ndarray, "P N Z"]:
        """Memory at every frame, integrated along the smoothed motion.

        ``theta`` (P, n) are the law's parameters, ``initial`` the memory's free values where clips begin.
        """
        p, dataset = direction.covector, self.dataset
        spring, drive = self.forces
        s, v = (dataset.smooth - self.model.rest) @ p, dataset.v @ p
        distinct, which = np.unique(np.concatenate([theta, initial], axis=1), axis=0, return_inverse=True)
        law_theta, free = distinct[:, : theta.shape[1]], distinct[:, theta.shape[1] :]
        out = np.zeros((len(distinct), len(s), effect.n_memory))
        begin = np.zeros((len(distinct), len(dataset.clips), effect.n_memory))
        for i, name in enumerate(effect.memory_start):
            values = {"zero": np.zeros_like(s), "s": s, "v": v}[name]
            begin[:, :, i] = values[dataset.clips[:, 0]]
        begin[:, list(effect.free_clips)] += free.reshape(len(free), -1, effect.n_memory)
        motion = np.stack([s, v, spring @ p / direction.inertia, drive @ p / direction.inertia], axis=1)
        law_theta = np.ascontiguousarray(law_theta)
        integrate_memory(effect.law.address, law_theta, dataset.time, motion, dataset.clips, begin, out)
        return out[which.reshape(-1)]


def _find_contacts(slots: Sequence[ForceSlot]) -> Int64[np.ndarray, " slots"]:
    """For each slot of dry friction, the first one along its direction; -1 for others."""
    first: dict[tuple[float, ...], int] = {}
    keys = [(*slot.acts.covector, slot.acts.inertia) for slot in slots]
    found = [-1 if slot.bristles < 0 else first.setdefault(keys[k], k) for k, slot in enumerate(slots)]
    return np.array(found, dtype=np.int64)


def _move_functions_last(coefficients: np.ndarray) -> np.ndarray:
    """Coefficients (P, K, ...) with the functions last, as the kernel takes them; (P, K) and (P, d) stay."""
    return np.ascontiguousarray(np.moveaxis(coefficients, 1, -1) if coefficients.ndim > 2 else coefficients)


@dataclass(frozen=True)
class CoefficientRollout:
    """Rollouts of ``model`` with its coefficients moved along ``moves``."""

    model: MechanicalModel
    dataset: Dataset
    windows: WindowSet
    moves: Float64[np.ndarray, "n K"]
    steps: int  # substeps between two frames
    held: bool  # inputs are held between samples (zero-order hold) instead of interpolated

    @cached_property
    def rollout_model(self) -> RolloutModel:
        """The rollouts, with the extent of each move as the only nuisance parameters."""
        d, n_u = self.model.d, self.model.n_u
        nuisance = NuisanceParameters(1.0, 1.0, 1.0, 1.0, np.ones(d), 1.0, n_u, self.moves)
        return RolloutModel(self.model, self.dataset, nuisance, self.steps, self.held)

    def __call__(self, x: np.ndarray, starts: np.ndarray) -> np.ndarray:
        """Coordinates (P, W, L, d) for moves ``x`` (P, n) and starts (P, W, 2 d)."""
        fixed = self.rollout_model.nuisance.size - len(self.moves)
        padded = np.concatenate([np.zeros((len(x), fixed)), x], axis=1)
        return self.rollout_model.roll_out((), padded, starts, self.windows)[0]
