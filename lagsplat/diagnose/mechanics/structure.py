"""The sizes that a sim's fields may have, and what may change in a model of a given size."""

from dataclasses import dataclass, replace

import numpy as np

from lagsplat.diagnose.mechanics.basis import Basis, add_angle_functions, make_polynomial_basis
from lagsplat.diagnose.mechanics.model import MechanicalModel

MAX_FEW_COORDINATES = 2
"""Coordinates up to which fields grow by two degrees at once and all slopes are taken at every step."""
COEFFICIENT_FIELDS = ("mass", "damping", "potential", "input_map", "dry", "drag")


def build_candidate_bases(q: np.ndarray, *, degree: int) -> list[Basis]:
    """Candidate bases over the region of ``q``: polynomials, and angles where the range allows them."""
    low, high = q.min(axis=0), q.max(axis=0)
    centre, scale = 0.5 * (low + high), np.maximum(0.5 * (high - low), 1e-9)
    out = [make_polynomial_basis(degree, centre=centre, scale=scale)]
    if (high - low > 0.6).all():
        d = len(low)
        multiples = [np.eye(d, dtype=np.int64)]
        for i in range(d):
            for j in range(i + 1, d):
                difference = np.zeros((2, d), dtype=np.int64)
                difference[:, i] = 1
                difference[0, j], difference[1, j] = -1, 1
                multiples.append(difference)
        # Beyond a whole turn a polynomial of one turn tells nothing of the next, if these are angles.
        around = bool((high - low > 2.0 * np.pi).all())
        plain = make_polynomial_basis(1 if around else 2, centre=centre, scale=scale)
        turning = add_angle_functions(plain, np.concatenate(multiples))
        out = [turning, *out] if around else [*out, turning]
    return out


def list_field_sizes(basis: Basis) -> list[int]:
    """Sizes at which a field may end: after each degree of the polynomials, and after the angles."""
    total = np.where(basis.kind == 0, basis.order.sum(axis=1), 99)
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
        """A measure of size, to prefer the smaller of two equals."""
        return (self.mass, self.potential, self.damping, self.input_map, self.dry, self.drag)


def list_larger_structures(form: ModelStructure, basis: Basis, *, driven: bool) -> list[ModelStructure]:
    """The forms that are one step larger."""
    ends = list_field_sizes(basis)
    ahead = 2 if basis.order.shape[1] <= MAX_FEW_COORDINATES else 1

    def larger(size: int) -> list[int]:
        return [end for end in ends if end > size][:ahead]

    out = [replace(form, potential=end) for end in larger(form.potential)]
    out += [replace(form, mass=end) for end in larger(form.mass) if end <= form.potential]
    out += [replace(form, damping=end) for end in larger(form.damping) if end <= form.potential]
    if driven:
        out += [replace(form, input_map=end) for end in larger(form.input_map) if end <= form.potential]
    if not form.dry:
        out.append(replace(form, dry=True))
    if not form.drag:
        out.append(replace(form, drag=True))
    return out


def pad_model(model: MechanicalModel, form: ModelStructure) -> MechanicalModel:
    """The same model with room for the coefficients of a larger form."""

    def pad(value: np.ndarray, size: int) -> np.ndarray:
        return np.concatenate([value, np.zeros((max(size - len(value), 0), *value.shape[1:]))])

    return replace(
        model,
        mass=pad(model.mass, form.mass),
        damping=pad(model.damping, form.damping),
        potential=pad(model.potential, form.potential),
        input_map=pad(model.input_map, form.input_map),
    )


def list_free_directions(model: MechanicalModel, form: ModelStructure, speed: np.ndarray) -> np.ndarray:
    """Moves (K_free, K) of all coefficients of a model of this form, one for each number that is free.

    Each is in a unit of its field, so that one size of step suits all: the inertia, the potential at the
    edge of the region, and the damping, friction and drag that take a twentieth of it at the rms speed.
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
    for k in range(form.mass):
        for i, j in pairs:
            size = float(np.sqrt(model.mass[0, i, i] * model.mass[0, j, j]))
            last = (0, d - 1, d - 1)
            if k == 0 and i == j == d - 1:
                continue  # the scale of inertia is fixed by the trace
            add("mass", size, (k, i, j), (k, j, i), minus=last if k == 0 and i == j else None)
    for k in range(1, form.potential):
        add("potential", height, (k,))
    for k in range(form.damping):
        for i, j in pairs:
            add("damping", loss, (k, i, j), (k, j, i))
    for k in range(form.input_map):
        for c in range(model.n_u):
            for i in range(d):
                add("input_map", reach or 1.0, (k, c, i))
    for name, flag, sizes in (("dry", form.dry, loss * speed), ("drag", form.drag, loss / speed)):
        for i in range(d) if flag else ():
            add(name, float(sizes[i]), (i,))
    return np.array(rows)


def shift_coefficients(model: MechanicalModel, change: np.ndarray) -> MechanicalModel:
    """The model with all its coefficients changed."""
    values, at = {}, 0
    for name in COEFFICIENT_FIELDS:
        value = getattr(model, name)
        values[name] = value + change[at : at + value.size].reshape(value.shape)
        at += value.size
    return replace(model, **values)
