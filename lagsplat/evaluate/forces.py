"""Everything that is measured of forces in the image, on one run."""

from collections.abc import Callable
from typing import Any

import numpy as np
from jaxtyping import Float64

from lagsplat.evaluate.force_energies import energy_spans
from lagsplat.evaluate.force_invariants import force_invariants
from lagsplat.evaluate.force_motion import at_once, in_time
from lagsplat.evaluate.force_truth import Read, compare, grips_at, matter
from lagsplat.evaluate.pokes import poke
from lagsplat.evaluate.polynomial import fit_polynomial
from lagsplat.forces.config import ForcesConfig
from lagsplat.forces.held import Held
from lagsplat.forces.scale import NoScaleError
from lagsplat.systems.config import SimulationConfig
from lagsplat.systems.pushable import Pushable, pushable
from lagsplat.systems.release_config import ReleaseConfig
from lagsplat.systems.truth import Truth

STEP = 1e-3


def measure_forces(
    held: Held,
    config: ForcesConfig,
    *,
    truth: Truth | None,
    driven: SimulationConfig | None,
    released: ReleaseConfig | None,
) -> dict[str, Any]:
    """The invariants, and of a simulated system with its ``truth`` the errors against the true answers; in
    place of the latter the reason where no energy scale makes the law answer the reference poke.

    Raises:
        ValueError: nothing moves in the picture.
    """
    found: dict[str, Any] = {"d": held.law.d, "invariants": force_invariants(held, config), "truth": None}
    if truth is not None:
        system = pushable(driven, released, pressure=held.u.numpy(), points=config.points)
        try:
            found["truth"] = against_truth(held, system, truth, config)
        except NoScaleError as error:
            found["truth"] = {"refused": str(error)}
    return found


def against_truth(held: Held, system: Pushable, truth: Truth, config: ForcesConfig) -> dict[str, Any]:
    """Static answers, answers in time and first motions, against those of the equations."""
    radius = config.brush * held.kinematics.width
    pokes = poke(system, truth.states[: held.chart.n_train], config)
    grips = grips_at(held, pokes.places, radius=radius)
    usable, field = matter(grips, held.law.d)
    found = compare(held, pokes, radius=radius, read=reader(held, system, truth.states))
    found["in_time"] = in_time(
        held, system, pokes, grips, field, usable,
        scale=found["brush"]["scale"], length_s=config.periods / float(truth.natural_frequencies_hz[0]),
    )  # fmt: skip
    found["energy_spans"] = energy_spans(held, system, slope_of(held, truth.states))
    found["at_once"] = at_once(held, system, pokes, grips, field, usable) if held.law.d > 1 else None
    return found


def reader(held: Held, system: Pushable, states: Float64[np.ndarray, "T n"]) -> Read:
    """Reads places of material points off latents, through a map fitted to the training frames."""
    to_states = state_map(held, states)

    def read(q: Float64[np.ndarray, "n d"]) -> Float64[np.ndarray, "n P 2"]:
        return system.pixels(to_states(q))

    return read


def slope_of(held: Held, states: Float64[np.ndarray, "T n"]) -> Float64[np.ndarray, "n d"]:
    """Derivatives of the true coordinates by the latents at rest, through the same map."""
    to_states, rest = state_map(held, states), held.rest.numpy()
    shifts = STEP * np.eye(len(rest))
    return ((to_states(rest + shifts) - to_states(rest - shifts)) / (2 * STEP)).T


def state_map(held: Held, states: Float64[np.ndarray, "T n"]) -> Callable[[np.ndarray], np.ndarray]:
    """From latents to true coordinates, fitted to the training frames."""
    smooth = held.chart.train.smoothed(held.chart.smoothing_frames).latents
    return fit_polynomial(smooth, states[: len(smooth)])
