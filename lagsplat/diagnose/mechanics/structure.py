"""The structure of a model: how many basis functions each field uses, and which coefficients are free."""

from dataclasses import dataclass, replace

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.mechanics.basis import POWER, Basis, add_angle_functions, make_polynomial_basis
from lagsplat.diagnose.mechanics.model import MechanicalModel

MAX_FEW_COORDINATES = 2
"""Up to so many coordinates the search is cheap: fields grow by up to two degrees at once."""
COEFFICIENT_FIELDS = ("mass", "damping", "potential", "input_map", "dry", "drag")
"""Fields of `MechanicalModel` that are estimated, in the order in which they are flattened."""
MIN_ANGLE_RANGE = 0.6
"""Range [rad] of every coordinate above which sines and cosines are tried beside polynomials."""


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
        multiples = [np.eye(d, dtype=np.int64)]
        for i in range(d):
            for j in range(i + 1, d):
                pair = np.zeros((2, d), dtype=np.int64)
                pair[:, i] = 1
                pair[0, j], pair[1, j] = -1, 1
                multiples.append(pair)
        # If these are angles, a polynomial that is fitted to one turn does not extend to the next.
        around = bool((high - low > 2.0 * np.pi).all())
        plain = make_polynomial_basis(1 if around else 2, centre=centre, scale=scale)
        turning = add_angle_functions(plain, np.concatenate(multiples))
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

    def larger(size: int) -> list[int]:
        return [end for end in ends if end > size][:ahead]

    candidates = [replace(structure, potential=end) for end in larger(structure.potential)]
    candidates += [
        replace(structure, mass=end) for end in larger(structure.mass) if end <= structure.potential
    ]
    candidates += [
        replace(structure, damping=end) for end in larger(structure.damping) if end <= structure.potential
    ]
    if driven:
        sizes = larger(structure.input_map)
        candidates += [replace(structure, input_map=end) for end in sizes if end <= structure.potential]
    if not structure.dry:
        candidates.append(replace(structure, dry=True))
    if not structure.drag:
        candidates.append(replace(structure, drag=True))
    return candidates


def pad_model(model: MechanicalModel, structure: ModelStructure) -> MechanicalModel:
    """The model with zeros appended to its coefficients, as many as a larger structure has."""

    def pad(value: np.ndarray, size: int) -> np.ndarray:
        return np.concatenate([value, np.zeros((max(size - len(value), 0), *value.shape[1:]))])

    return replace(
        model,
        mass=pad(model.mass, structure.mass),
        damping=pad(model.damping, structure.damping),
        potential=pad(model.potential, structure.potential),
        input_map=pad(model.input_map, structure.input_map),
    )


def list_free_directions(model: MechanicalModel, structure: ModelStructure, speed: np.ndarray) -> np.ndarray:
    """Directions (K_free, K) in the space of all coefficients, one for each number that is free.

    Each is scaled by the size of its field, so that one size of step suits all: the inertia, the potential at
    the edge of the region, and the damping, friction and drag that dissipate a twentieth of it at the rms
    speed ``speed`` (d,).
    """
    d, rows = model.d, []
    blank = {name: np.zeros_like(getattr(model, name)) for name in COEFFICIENT_FIELDS}
    height = float(np.abs(model.potential).max()) or 1.0
    reach = float(np.abs(model.input_map).max()) if model.input_map.size else 0.0
    loss = 0.05 * height / float(np.mean(speed * model.basis.scale))

    def add(name: str, value: float, *places: tuple[int, ...], minus: tuple[int, ...] | None = None) -> None:
        field = np.zeros_like(blank[name])
        for place in places:
            field[place] = value
        if minus is not None:
            field[minus] = -value
        rows.append(np.concatenate([(blank | {name: field})[n].ravel() for n in COEFFICIENT_FIELDS]))

    pairs = [(i, j) for i in range(d) for j in range(i, d)]
    for k in range(structure.mass):
        for i, j in pairs:
            size = float(np.sqrt(model.mass[0, i, i] * model.mass[0, j, j]))
            last = (0, d - 1, d - 1)
            if k == 0 and i == j == d - 1:
                continue  # the scale of inertia is fixed by the trace
            add("mass", size, (k, i, j), (k, j, i), minus=last if k == 0 and i == j else None)
    for k in range(1, structure.potential):
        add("potential", height, (k,))
    for k in range(structure.damping):
        for i, j in pairs:
            add("damping", loss, (k, i, j), (k, j, i))
    for k in range(structure.input_map):
        for c in range(model.n_u):
            for i in range(d):
                add("input_map", reach or 1.0, (k, c, i))
    for name, flag, sizes in (("dry", structure.dry, loss * speed), ("drag", structure.drag, loss / speed)):
        for i in range(d) if flag else ():
            add(name, float(sizes[i]), (i,))
    return np.array(rows)


def shift_coefficients(model: MechanicalModel, change: np.ndarray) -> MechanicalModel:
    """The model with ``change`` (K,) added to all its coefficients, in the order of `COEFFICIENT_FIELDS`."""
    values, at = {}, 0
    for name in COEFFICIENT_FIELDS:
        value = getattr(model, name)
        values[name] = value + change[at : at + value.size].reshape(value.shape)
        at += value.size
    return replace(model, **values)


def flatten_coefficients(model: MechanicalModel) -> Float64[np.ndarray, " K"]:
    """All coefficients of a model in a single row, in the order of `COEFFICIENT_FIELDS`."""
    return np.concatenate([getattr(model, name).ravel() for name in COEFFICIENT_FIELDS])
