"""A simulator that is a Python object: ``sim=package.module:attribute`` or ``sim=file.py:attribute``.

The attribute is a callable ``(q, v, u) -> acceleration``, or an object with ``mass(q)`` and
``potential_gradient(q)`` or ``potential(q)``, and, where it has them, ``damping(q)``, ``friction(q, v)`` and
``input_map(q)`` (inputs by coordinates); or something that returns one of these when called without
arguments. Functions may take NumPy arrays or torch tensors, a single point or many. The file is the user's
own program and is executed.
"""

import importlib
import importlib.util
import inspect
import sys
import warnings
from collections.abc import Callable
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from lagsplat.diagnose.estimation.dataset import OperatingRegion
from lagsplat.diagnose.simulators.projection import FieldFunctions, ProjectedModel, project_fields
from lagsplat.diagnose.simulators.projection_acceleration import project_acceleration

ROUNDING_POWER_SHARE = 1e-9  # power that damping feeds in by rounding, relative to the reactive power
EXPECTED_METHODS = "mass(q), potential_gradient(q) or potential(q), damping(q), friction(q, v), input_map(q)"


def load_python(name: str) -> Any:
    """Import the object that ``module:attribute`` or ``file.py:attribute`` names.

    Raises:
        FileNotFoundError: there is no such file.
        ValueError: no such module or attribute, or the program fails when it is imported or called.
    """
    source, _, attribute = name.rpartition(":")
    if source.endswith(".py") and not Path(source).is_file():
        raise FileNotFoundError(f"{source}: no such file; sim=file.py:attribute names a Python file")
    try:
        module = _import_file(Path(source)) if source.endswith(".py") else importlib.import_module(source)
    except ModuleNotFoundError as error:
        raise ValueError(
            f"sim={name}: {error}; give file.py:attribute, or install the package of the module"
        ) from error
    except (Exception, SystemExit) as error:  # a program that ends itself must not end the diagnosis
        raise ValueError(
            f"sim={name}: importing {source} fails with {error!r}; run it alone first"
        ) from error
    if not hasattr(module, attribute):
        public = [key for key in vars(module) if not key.startswith("_")]
        raise ValueError(f"sim={name}: {source} has no {attribute!r}, only {public[:12]}")
    value = getattr(module, attribute)
    if not _is_factory(value):
        return value
    try:
        return value()
    except (Exception, SystemExit) as error:
        raise ValueError(f"sim={name}: {attribute}() fails with {error!r}") from error


def _import_file(path: Path) -> Any:
    spec = importlib.util.spec_from_file_location(f"_sim_{path.stem}", path)
    assert spec is not None
    assert spec.loader is not None
    module = importlib.util.module_from_spec(spec)
    sys.modules[spec.name] = module  # dataclasses look their module up there
    spec.loader.exec_module(module)
    return module


def _is_factory(value: Any) -> bool:
    if inspect.isclass(value):
        return True
    return callable(value) and not hasattr(value, "mass") and _count_arguments(value) == 0


def _count_arguments(function: Any) -> int | None:
    """Number of arguments that a function requires; None if it is variable or unknown."""
    try:
        parameters = inspect.signature(function).parameters.values()
    except (TypeError, ValueError):
        return None
    if any(p.kind is p.VAR_POSITIONAL for p in parameters):
        return None
    positional = [p for p in parameters if p.kind in (p.POSITIONAL_ONLY, p.POSITIONAL_OR_KEYWORD)]
    return sum(p.default is p.empty for p in positional)


def project_python(sim: Any, region: OperatingRegion, *, what: str) -> ProjectedModel:
    """The model of a Python simulator over a region; ``what`` names it in messages.

    Raises:
        ValueError: it has neither mass and potential nor an acceleration, or they return other shapes, NaN,
        a mass that is not symmetric and positive, or a gradient that is not that of the potential.
    """
    if hasattr(sim, "mass"):
        projected = project_fields(_make_fields(sim, region, what), region, what=what)
    elif callable(sim):
        projected = project_acceleration(_make_acceleration(sim, region, what), region, what=what)
    else:
        raise ValueError(
            f"{what}: a {type(sim).__name__} is no sim; give a callable (q, v, u) -> acceleration, or an "
            f"object with {EXPECTED_METHODS}"
        )
    _warn_if_active(projected, region, what)
    return projected


def _adapt(
    function: Callable[..., Any], shape: tuple[int, ...], what: str, *points: np.ndarray
) -> Callable[..., np.ndarray]:
    """A user's function of a single point or of many, of NumPy or of torch, as one of many NumPy points.

    What it takes is found out at the first few of ``points``. ``shape`` is that of its result at a single
    point, ``what`` names it in messages.

    Raises:
        ValueError: it fails, or returns something of another shape or type.
    """
    point, few = tuple(x[0] for x in points), tuple(x[:3] for x in points)
    call = partial(_call_numpy, function)
    try:
        first = call(*point)
    except (Exception, SystemExit) as plain:
        call = partial(_call_torch, function)
        try:
            first = call(*point)
        except (Exception, SystemExit) as error:
            cause = plain if type(plain) is type(error) else error
            at = ", ".join(np.array2string(x, precision=4) for x in point)
            raise ValueError(f"{what} fails at {at} with {cause!r}, also with torch tensors") from plain
    if first.size != int(np.prod(shape)):
        raise ValueError(f"{what} has shape {first.shape} at one point, where {shape} is wanted")

    def call_each(*many: np.ndarray) -> np.ndarray:
        return np.stack([call(*each) for each in zip(*many, strict=True)]).reshape(-1, *shape)

    alone = call_each(*few)
    try:
        together = call(*few)
        close = 1e-9 * float(np.abs(alone).max())
        same = together.shape == alone.shape
        same = same and np.allclose(together, alone, rtol=1e-6, atol=close, equal_nan=True)
    except Exception:
        same = False  # a function of a single point may raise anything when given many
    return call if same else call_each


def _call_numpy(function: Callable[..., Any], *points: np.ndarray) -> np.ndarray:
    return np.asarray(function(*points), dtype=np.float64)


def _call_torch(function: Callable[..., Any], *points: np.ndarray) -> np.ndarray:
    import torch

    value = function(*(torch.as_tensor(x, dtype=torch.float64) for x in points))
    return np.asarray(torch.as_tensor(value).detach().cpu().numpy(), dtype=np.float64)


def _make_acceleration(sim: Callable[..., Any], region: OperatingRegion, what: str) -> Callable[..., Any]:
    takes = _count_arguments(sim)
    if takes not in (None, 2, 3):
        raise ValueError(f"{what}: takes {takes} arguments; (q, v, u) or (q, v) -> acceleration is needed")
    function = (lambda q, v, u: sim(q, v)) if takes == 2 else sim
    return _adapt(function, (region.d,), f"{what}: acceleration(q, v, u)", region.q, region.v, region.u)


def _make_fields(sim: Any, region: OperatingRegion, what: str) -> FieldFunctions:
    q, v, d, n_u = region.q, region.v, region.d, region.n_u

    def field(name: str, shape: tuple[int, ...], *points: np.ndarray) -> Callable[..., np.ndarray] | None:
        if not hasattr(sim, name):
            return None
        given = getattr(sim, name)
        function = given if callable(given) else lambda *at: given
        return _adapt(function, shape, f"{what}: {name}", *points)

    mass, potential = field("mass", (d, d), q), field("potential", (), q)
    gradient = field("potential_gradient", (d,), q)
    damping, friction = field("damping", (d, d), q), field("friction", (d,), q, v)
    input_map = field("input_map", (n_u, d), q) if n_u else None
    assert mass is not None
    if potential is not None:
        measured = partial(_differentiate, potential, motion=q)
        if gradient is not None:
            given, expected = gradient(q), measured(q)
            off = np.abs(given - expected).max() / max(np.abs(expected).max(), np.abs(given).max(), 1e-300)
            if off > 1e-3:
                raise ValueError(
                    f"{what}: potential_gradient(q) is not the gradient of potential(q), off by "
                    f"{100.0 * off:.2g} % of its largest value; check its sign and units"
                )
        gradient = gradient or measured
    if gradient is None:
        raise ValueError(f"{what}: has mass(q) but no potential; an object needs {EXPECTED_METHODS}")
    masses = mass(q)
    asymmetry = float(np.abs(masses - masses.mT).max() / np.abs(masses).max())
    if asymmetry > 1e-6:
        raise ValueError(f"{what}: mass(q) is not symmetric (by {asymmetry:.2g} of its largest entry)")
    if n_u and input_map is None:
        warnings.warn(
            f"{what}: the recording has {n_u} input(s), but the sim has no input_map(q); it is taken as not "
            "driven",
            stacklevel=3,
        )

    def dissipation(q: np.ndarray, v: np.ndarray) -> np.ndarray:
        force = np.zeros_like(q) if damping is None else np.einsum("nij,nj->ni", damping(q), v)
        return force if friction is None else force + friction(q, v)

    input_map = input_map or (lambda at: np.zeros((len(at), n_u, d)))
    return FieldFunctions(mass, gradient, input_map, dissipation)


def _differentiate(potential: Callable[..., np.ndarray], q: np.ndarray, *, motion: np.ndarray) -> np.ndarray:
    """The gradient (N, d) at ``q`` by central differences of fourth order, in steps of the motion's range."""
    columns = []
    for h in 2e-3 * np.diag(np.maximum(np.ptp(motion, axis=0), 1e-9)):
        near = potential(q + h) - potential(q - h)
        far = potential(q + 2.0 * h) - potential(q - 2.0 * h)
        columns.append((8.0 * near - far) / (12.0 * h.sum()))
    return np.stack(columns, axis=1)


def _warn_if_active(projected: ProjectedModel, region: OperatingRegion, what: str) -> None:
    """Warn if the damping feeds energy into the motion, which no passive mechanism does."""
    model, v = projected.model, region.v
    damping = model.damping_at(region.q)
    power = np.einsum("ni,nij,nj->n", v, damping, v)
    power += np.abs(v) @ model.dry + np.abs(v) ** 3 @ model.drag
    rate = model.acceleration(region.q, v, region.u)
    swing = np.abs(np.einsum("ni,nij,nj->n", v, model.mass_at(region.q), rate)).max()
    # a simulator without friction has a damping by rounding alone
    if (power < -max(1e-3 * np.abs(power).max(), max(projected.error, ROUNDING_POWER_SHARE) * swing)).any():
        lowest = np.linalg.eigvalsh(damping).min(axis=1)
        at = np.array2string(region.q[int(np.argmin(lowest))], precision=4)
        warnings.warn(
            f"{what}: its damping feeds energy into the motion near q = {at}; check the sign of "
            "its velocity terms",
            stacklevel=3,
        )
