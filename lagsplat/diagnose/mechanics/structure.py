"""The structure of a model: how many basis functions each field uses, and which coefficients are free."""

from dataclasses import dataclass, replace
from itertools import combinations
from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.mechanics.basis import POWER, Basis, add_angle_functions, make_polynomial_basis
from lagsplat.diagnose.mechanics.model import MechanicalModel

MAX_FEW_COORDINATES = 2  # up to so many the search is cheap, and fields grow by up to two degrees at once
SIZED_FIELDS = ("mass", "damping", "potential", "input_map")
"""Fields of `MechanicalModel` in the basis, whose numbers of functions `ModelStructure` says."""
COEFFICIENT_FIELDS = (*SIZED_FIELDS, "dry", "drag")
"""Fields of `MechanicalModel` that are estimated, in the order in which they are flattened."""
MIN_ANGLE_RANGE = 0.6  # of every coordinate, above which sines and cosines are tried beside polynomials [rad]


def build_candidate_bases(q: np.ndarray, *, degree: int) -> list[Basis]:
    """Candidate bases over the region of ``q`` (N, d), the preferred one first.

    Polynomials up to ``degree``, and a quadratic with cosines and sines of the coordinates and of their sums
    and differences, where the coordinates move far enough to be angles.
    """
    low, high = q.min(axis=0), q.max(axis=0)
    centre, scale = 0.5 * (low + high), np.maximum(0.5 * (high - low), 1e-9)
    candidates = [make_polynomial_basis(degree, centre=centre, scale=scale)]
    if (high - low > MIN_ANGLE_RANGE).all():
        d = len(low)
        single = np.eye(d, dtype=np.int64)
        pairs = [single[i] + sign * single[j] for i, j in combinations(range(d), 2) for sign in (-1, 1)]
        # If these are angles, a polynomial that is fitted to one turn does not extend to the next.
        around = bool((high - low > 2.0 * np.pi).all())
        plain = make_polynomial_basis(1 if around else 2, centre=centre, scale=scale)
        turning = add_angle_functions(plain, np.array([*single, *pairs]))
        candidates = [turning, *candidates] if around else [*candidates, turning]
    return candidates


def list_field_sizes(basis: Basis) -> list[int]:
    """Numbers of functions that a field may use: up to each degree of the polynomials, and all of them."""
    total = np.where(basis.kind == POWER, basis.order.sum(axis=1), 99)  # angles come after every degree
    return [int(np.sum(total <= level)) for level in np.unique(total)]


@dataclass(frozen=True)
class ModelStructure:
    """How many functions of the basis each field uses, and whether there is dry friction or drag."""

    mass: int
    damping: int
    potential: int
    input_map: int
    dry: bool = False
    drag: bool = False

    @property
    def order(self) -> tuple[int, ...]:
        """Sizes of the fields, to prefer the smaller of two structures that fit equally well."""
        return (self.mass, self.potential, self.damping, self.input_map, self.dry, self.drag)


def list_larger_structures(structure: ModelStructure, basis: Basis, *, driven: bool) -> list[ModelStructure]:
    """The structures that are larger than ``structure`` by a single step of one field."""
    ends = list_field_sizes(basis)
    ahead = 2 if basis.order.shape[1] <= MAX_FEW_COORDINATES else 1

    fields = [("potential", ends[-1]), ("mass", structure.potential), ("damping", structure.potential)]
    fields += [("input_map", structure.potential)] if driven else []
    steps: list[dict[str, Any]] = [
        {name: end}
        for name, most in fields
        for end in [end for end in ends if end > getattr(structure, name)][:ahead]
        if end <= most
    ]
    steps += [{name: True} for name in ("dry", "drag") if not getattr(structure, name)]
    return [replace(structure, **step) for step in steps]


def pad_model(model: MechanicalModel, structure: ModelStructure) -> MechanicalModel:
    """The model with zeros appended to its coefficients, as many as a larger structure has."""

    def pad(value: np.ndarray, size: int) -> np.ndarray:
        return np.concatenate([value, np.zeros((max(size - len(value), 0), *value.shape[1:]))])

    fields: dict[str, Any] = {}
    for name in SIZED_FIELDS:
        fields[name] = pad(getattr(model, name), getattr(structure, name))
    return replace(model, **fields)


def list_free_directions(model: MechanicalModel, structure: ModelStructure, speed: np.ndarray) -> np.ndarray:
    """Directions (K_free, K) in the space of all coefficients, one for each number that is free.

    Each is scaled by the size of its field, so that one size of step suits all: the inertia, the potential at
    the edge of the region, and the damping, friction and drag that dissipate a twentieth of it at the rms
    speed ``speed`` (d,).
    """
    d, rows = model.d, []
    height = float(np.abs(model.potential).max()) or 1.0
    reach = float(np.abs(model.input_map).max()) if model.input_map.size else 0.0
    loss = 0.05 * height / float(np.mean(speed * model.basis.scale))

    def add(name: str, value: float, *places: tuple[int, ...], minus: tuple[int, ...] | None = None) -> None:
        rows.append(np.zeros_like(flatten_coefficients(model)))
        field = split_coefficients(rows[-1], model)[name]  # a view of the row
        for place in places:
            field[place] = value
        if minus is not None:
            field[minus] = -value

    pairs, last = [(i, j) for i in range(d) for j in range(i, d)], (0, d - 1, d - 1)
    for k in range(structure.mass):
        for i, j in pairs:
            if (k, i, j) != last:  # the scale of inertia is fixed by the trace
                size = float(np.sqrt(model.mass[0, i, i] * model.mass[0, j, j]))
                add("mass", size, (k, i, j), (k, j, i), minus=last if k == 0 and i == j else None)
    for k in range(1, structure.potential):
        add("potential", height, (k,))
    for k in range(structure.damping):
        for i, j in pairs:
            add("damping", loss, (k, i, j), (k, j, i))
    for place in np.ndindex(structure.input_map, model.n_u, d):
        add("input_map", reach or 1.0, place)
    for i in range(d if structure.dry else 0):
        add("dry", float(loss * speed[i]), (i,))
    for i in range(d if structure.drag else 0):
        add("drag", float(loss / speed[i]), (i,))
    return np.array(rows)


def split_coefficients(values: np.ndarray, model: MechanicalModel) -> dict[str, np.ndarray]:
    """Rows (..., K) of one value for each coefficient, by field, shaped (..., *field) as in ``model``."""
    fields = [getattr(model, name) for name in COEFFICIENT_FIELDS]
    parts = np.split(values, np.cumsum([field.size for field in fields])[:-1], axis=-1)
    shapes = [(*values.shape[:-1], *field.shape) for field in fields]
    return dict(zip(COEFFICIENT_FIELDS, map(np.reshape, parts, shapes), strict=True))


def shift_coefficients(model: MechanicalModel, change: np.ndarray) -> MechanicalModel:
    """The model with ``change`` (K,) added to all its coefficients, in the order of `COEFFICIENT_FIELDS`."""
    changes = split_coefficients(change, model)
    return replace(model, **{name: getattr(model, name) + part for name, part in changes.items()})


def flatten_coefficients(model: MechanicalModel) -> Float64[np.ndarray, " K"]:
    """All coefficients of a model in a single row, in the order of `COEFFICIENT_FIELDS`."""
    return np.concatenate([getattr(model, name).ravel() for name in COEFFICIENT_FIELDS])


def sum_symmetric(amounts: np.ndarray, d: int) -> Float64[np.ndarray, "K d d"]:
    """Symmetric matrices, one a basis function, from the amounts of `make_symmetric_basis`."""
    pairs = make_symmetric_basis(d)
    return np.einsum("kp,pij->kij", amounts.reshape(-1, len(pairs)), pairs)


def make_symmetric_basis(d: int) -> Float64[np.ndarray, "P d d"]:
    """A basis of the symmetric d x d matrices: a single one on the diagonal, or a pair beside it."""
    rows, columns = np.triu_indices(d)
    matrices, index = np.zeros((len(rows), d, d)), np.arange(len(rows))
    matrices[index, rows, columns] = matrices[index, columns, rows] = 1.0
    return matrices
