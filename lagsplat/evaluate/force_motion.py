"""How a law that never saw a force begins to move under one, and how it goes on."""

from typing import Any

import numpy as np
import torch
from jaxtyping import Bool, Float64

from lagsplat.evaluate.force_truth import alike, loads_of
from lagsplat.evaluate.pokes import Pokes
from lagsplat.forces.grip import Grip
from lagsplat.forces.held import Held
from lagsplat.forces.rollout import push_along
from lagsplat.stage2.induced import InducedMass
from lagsplat.systems.pushable import Pushable

TRIALS = 12
"""Points whose answer in time is followed: each takes an integration of the truth."""
FLOOR = 1e-9


def easiest(pokes: Pokes, grips: list[Grip | None], level: int) -> list[int]:
    """The poke of least force at every point, as far as it can be taken hold of and has a true answer."""
    usable = np.isfinite(pokes.distance[:, level]) & np.array([grips[p] is not None for p in pokes.point])
    found = []
    for p in np.unique(pokes.point[usable]):
        own = np.flatnonzero(usable & (pokes.point == p))
        found.append(int(own[pokes.size[own, level].argmin()]))
    return found


def in_time(
    held: Held,
    system: Pushable,
    pokes: Pokes,
    grips: list[Grip | None],
    field: Float64[np.ndarray, "P 2 d"],
    usable: Bool[np.ndarray, " P"],
    *,
    scale: float,
    length_s: float,
) -> dict[str, Any]:
    """The answer to a force switched on at rest and held, over ``length_s``, ready for JSON.

    ``error`` is the rms difference of the ways of all points over the rms of the true ways, ``shape`` what
    is left of it after the best factor; medians and 90th percentiles over at most `TRIALS` points.
    """
    level, dt_s = pokes.reference, held.chart.dt_s
    chosen = easiest(pokes, grips, level)
    chosen = [chosen[i] for i in np.unique(np.linspace(0, len(chosen) - 1, TRIALS).round().astype(int))]
    time_s = dt_s * np.arange(max(3, round(length_s / dt_s) + 1))
    true = np.stack(
        [
            system.pixels(system.moved(pokes.point[i], pokes.forces[i, level], time_s=time_s)) - pokes.places
            for i in chosen
        ]
    )
    loads = torch.from_numpy(scale * loads_of(pokes, grips, held.law.d)[chosen, level])
    rows, steps = len(chosen), len(time_s)
    q, _ = push_along(
        held.law,
        held.rest.expand(rows, -1),
        torch.zeros(rows, held.law.d, dtype=torch.float64),
        held.u.expand(rows, steps, -1),
        loads[:, None].expand(-1, steps, -1),
        dt_s=dt_s,
    )
    ways = np.einsum("pcd,btd->btpc", field, q.numpy() - held.rest.numpy())[:, :, usable]
    true = true[:, :, usable]
    size = np.sqrt(np.mean(true**2, axis=(1, 2, 3)))
    error = np.sqrt(np.mean((ways - true) ** 2, axis=(1, 2, 3))) / size
    cosine, _ = alike(ways.reshape(rows, 1, -1, 2), true.reshape(rows, 1, -1, 2))
    shape = np.sqrt(1.0 - np.clip(cosine[:, 0], 0.0, 1.0) ** 2)
    told = {"n": rows, "length_s": float(time_s[-1])}
    for name, values in (("error", error), ("shape", shape)):
        told |= {name: float(np.median(values)), f"{name}_p90": float(np.quantile(values, 0.9))}
    return told


def at_once(
    held: Held,
    system: Pushable,
    pokes: Pokes,
    grips: list[Grip | None],
    field: Float64[np.ndarray, "P 2 d"],
    usable: Bool[np.ndarray, " P"],
) -> dict[str, float]:
    """Shape error of the first motion, ``M^-1 J^T f``, with three masses; medians over the points.

    ``learned`` is the law's own mass, ``uniform`` the one that equally heavy Gaussians induce, ``true`` the
    one that the true masses of the bodies induce, each spread evenly over its body's material points. With
    one coordinate the three agree: the mass is a factor then.

    Source: paper eq. (latent-metric), "we take the density to be uniform".
    """
    rest, level = held.rest[None], pokes.reference
    chosen = easiest(pokes, grips, level)
    induced = InducedMass(held.kinematics.geometry, scale=1.0, floor=FLOOR)
    by_share = np.einsum("p,pca,pcb->ab", system.share * usable, field, field)
    with torch.no_grad():
        masses = {
            "learned": held.law.mass(rest)[0].numpy(),
            "uniform": induced.matrix(rest)[0].numpy(),
            "true": by_share + FLOOR * np.trace(by_share) * np.eye(held.law.d),
        }
    jacobian = system.jacobian(system.rest)
    felt = np.stack([pokes.forces[i, level] @ jacobian[pokes.point[i]] for i in chosen])
    true = np.einsum("pcd,nd->npc", jacobian, np.linalg.solve(system.mass(system.rest), felt.T).T)
    loads = loads_of(pokes, grips, held.law.d)[chosen, level]
    found = {}
    for name, mass in masses.items():
        ways = np.einsum("pcd,nd->npc", field, np.linalg.solve(mass, loads.T).T)
        cosine, _ = alike(ways[:, None][:, :, usable], true[:, None][:, :, usable])
        found[name] = float(np.median(np.sqrt(1.0 - np.clip(cosine, 0.0, 1.0) ** 2)))
    return found
