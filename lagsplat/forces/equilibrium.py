"""Where a law settles under held inputs and held forces: the minimum of ``V - u.nu - load.q``.

A fitted run held at one operating point, ready to be pushed.

The one number that a film does not tell: how much energy of the law is a joule.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64
from torch import Tensor

from lagsplat.array_types import Inputs, Latents
from lagsplat.chart.chart import Chart
from lagsplat.forces.grasp import GraspPoint, MatterKinematics, compute_kinematics
from lagsplat.forces.loaded_lagrangian import LoadedLagrangian
from lagsplat.splat.projection import View
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage2.lagrangian import UNTOUCHED, Lagrangian, LawEdits, PreparedCoefficients

ITERATIONS = 200
TOLERANCE = 1e-10
"""Of the force left over, relative to the load and to the force that a whitened unit takes at the start."""
LEAST_CURVATURE = 1e-6
"""Relative to the largest: below it, or negative, a curvature is replaced before the step."""
DECREASE = 1e-4
UNRESOLVED = 1e-12
"""Of the energy, or of one: gains below it drown in rounding, and Newton's step is taken as it is."""
SHORTEST = 2.0**-40


class NotSettledError(ValueError):
    """An equilibrium that was not reached, for instance because the energy left the finite numbers."""


def settle(
    law: Lagrangian,
    u: Inputs,
    load: Float[Tensor, "B d"],
    *,
    edits: LawEdits = UNTOUCHED,
    start: Float[Tensor, " d"] | None = None,
) -> Latents:
    """The equilibria (B, d) under inputs ``u`` and generalised forces ``load``, one a row.

    Newton's method on the energy: where its Hessian is not positive definite its eigenvalues are replaced by
    their size, so that each direction descends, and a step is halved until the energy falls by Armijo's rule.
    The energy is coercive (the quadratic floor of ``V`` outgrows a load, linear in ``q``), so its lower level
    sets are compact and every limit point is stationary, whatever the networks learned and however large the
    load. Begins at ``start``, or at the law's rest state.

    Raises:
        NotSettledError: the load is so large that energies overflow, or the iterations do not suffice.
        ValueError: a load that is not finite.

    Source: paper, Appendix "Bounded forced response"; Nocedal and Wright, Numerical Optimization, ch. 3.
    """
    loaded = LoadedLagrangian(law, load, edits=edits)
    first = law.rest.detach() if start is None else start
    q = first.expand(len(load), -1).clone()
    ready = loaded.prepare()
    force, hessian = _slopes(loaded, q, u, ready)
    scale = load.norm(dim=1) + hessian.abs().amax((1, 2))
    overflow = not bool(torch.isfinite(scale).all())
    for _ in range(0 if overflow else ITERATIONS):
        left = ~(force.norm(dim=1) <= TOLERANCE * scale)  # what is not a number is left, too
        if not bool(left.any()):
            return _polish(loaded, q, u, force, hessian, ready)
        q = torch.where(left[:, None], _descend(loaded, q, u, force, hessian), q)
        force, hessian = _slopes(loaded, q, u, ready)
    worst = int((force.norm(dim=1) / scale).nan_to_num(torch.inf).argmax())
    raise NotSettledError(
        f"no equilibrium was reached in {ITERATIONS} steps under the load {load[worst].tolist()}: "
        f"{float(force[worst].norm() / scale[worst]):.1e} of the force is left at q = {q[worst].tolist()}; "
        "lower the force, or look at the law's potential"
    )


def compute_loaded_energy(law: Lagrangian, q: Latents, u: Inputs) -> Float[Tensor, " B"]:
    """``V - u.nu``, and less the work of the load if there is one."""
    return law.potential(q) - (law.volume(q, u) * u).sum(1)


def compute_static_stiffness(law: Lagrangian, q: Latents, u: Inputs) -> Float[Tensor, "B d d"]:
    """The symmetric Hessian of the energy at ``q``."""
    return _slopes(law, q, u, law.prepare())[1]


def _slopes(
    law: Lagrangian, q: Latents, u: Inputs, ready: PreparedCoefficients
) -> tuple[Latents, Float[Tensor, "B d d"]]:
    """Force at ``q`` and the symmetric Hessian of the energy."""
    with torch.enable_grad():
        point = q.detach().requires_grad_()
        force = law.conservative_force(point, u, ready)
        rows = [torch.autograd.grad(part.sum(), point, retain_graph=True)[0] for part in force.unbind(1)]
    hessian = -torch.stack(rows, 1).detach()
    return force.detach(), 0.5 * (hessian + hessian.mT)


@torch.no_grad()
def _descend(
    law: Lagrangian, q: Latents, u: Inputs, force: Latents, hessian: Float[Tensor, "B d d"]
) -> Latents:
    values, vectors = torch.linalg.eigh(hessian.nan_to_num())
    size = values.abs()
    size = size.clamp(min=LEAST_CURVATURE * size.amax(1, keepdim=True).clamp(min=1e-300))
    step = (vectors @ ((vectors.mT @ force[:, :, None])[:, :, 0] / size)[:, :, None])[:, :, 0]
    gain = (step * force).sum(1)
    before = compute_loaded_energy(law, q, u)
    fine = gain <= UNRESOLVED * (1.0 + before.abs())
    length = torch.ones_like(gain)
    while True:
        after = compute_loaded_energy(law, q + length[:, None] * step, u)
        falls: Bool[Tensor, " B"] = fine | (after <= before - DECREASE * length * gain)
        if bool(falls.all()) or float(length.min()) < SHORTEST:
            return torch.where(falls[:, None], q + length[:, None] * step, q)
        length = torch.where(falls, length, 0.5 * length)


@torch.no_grad()
def _polish(
    law: Lagrangian,
    q: Latents,
    u: Inputs,
    force: Latents,
    hessian: Float[Tensor, "B d d"],
    ready: PreparedCoefficients,
) -> Latents:
    """After one more Newton step where that leaves less of the force: differences of answers are small."""
    closer = q + torch.linalg.solve_ex(hessian, force[:, :, None])[0][:, :, 0]
    left = law.conservative_force(closer, u, ready).norm(dim=1)
    return torch.where((left < force.norm(dim=1))[:, None], closer, q)


VISITED = 0.99
"""Quantile of the training states' distances from the rest: what lies further was hardly seen."""
MAGNITUDES = 60
SPAN = 1e4
STILL = 1e-6
"""Of the largest Jacobian: matter that moves less does not move."""


@dataclass(frozen=True)
class OperatingPoint:
    """A law at rest under the constant inputs ``u`` (n_u,), in the state ``rest`` (d,); ``reach`` is how
    far training states lie from there, the 99th percentile [whitened units].

    Example:
        >>> import lagsplat
        >>> point = lagsplat.hold("run")
        >>> point.rest.shape
        torch.Size([2])
    """

    autoencoder: Autoencoder
    chart: Chart
    law: Lagrangian
    kinematics: MatterKinematics
    u: Float[Tensor, " n_u"]
    rest: Float[Tensor, " d"]
    visited_radius: float

    def equilibria(self, loads: Float[Tensor, "B d"]) -> Latents:
        """Equilibria under generalised forces, one a row."""
        return settle(self.law, self.u.expand(len(loads), -1), loads, start=self.rest)

    def render_images(
        self, q: Latents, *, scale: int = 1, view: View | None = None
    ) -> Float[np.ndarray, "B H W 3"]:
        """Pictures at whitened states, ``scale`` times as large as in training; in space of any camera."""
        raw = torch.from_numpy(self.chart.to_raw(q.numpy())).to(self.autoencoder.gaussians.center)
        with torch.no_grad():
            drawn = self.autoencoder.decode(
                raw, view=view, height=scale * self.kinematics.height, width=scale * self.kinematics.width
            )
        return np.moveaxis(drawn.cpu().numpy(), 1, 3)

    def find_force_size(
        self, grip: GraspPoint, direction: Float64[np.ndarray, " n"], *, share: float
    ) -> float:
        """The force along ``direction`` on ``grip`` that drives the state ``share`` of the reach away.

        In the law's own units of energy per pixel. Found among forces four decades apart at most, around what
        the stiffness at rest asks for, and interpolated.

        Raises:
            ValueError: the matter there does not move along ``direction``.
        """
        unit = grip.pull_back(torch.from_numpy(direction))
        if not float(unit.norm()) > STILL * float(self.kinematics.geometry.jacobian.abs().max()):
            raise ValueError(
                f"a force along {direction.tolist()} moves nothing at {grip.at.tolist()}: the matter there "
                "does not move that way; choose another point or direction"
            )
        small = 1e-3 * self.visited_radius / float(unit.norm())
        answer = float((self.equilibria(small * unit[None])[0] - self.rest).norm())
        linear = share * self.visited_radius * small / answer
        sizes = torch.from_numpy(np.geomspace(linear / np.sqrt(SPAN), linear * np.sqrt(SPAN), MAGNITUDES))
        away = (self.equilibria(sizes[:, None] * unit) - self.rest).norm(dim=1) / self.visited_radius
        return float(np.exp(np.interp(np.log(share), away.log().numpy(), sizes.log().numpy())))


def hold_at_load(
    autoencoder: Autoencoder, chart: Chart, law: Lagrangian, u: Float64[np.ndarray, " n_u"] | None = None
) -> OperatingPoint:
    """A run at rest under constant inputs: the mean of the training ones unless told otherwise."""
    inputs = torch.from_numpy(chart.train.inputs.mean(0) if u is None else u)
    rest = settle(law, inputs[None], torch.zeros(1, law.d, dtype=torch.float64))[0]
    away = np.linalg.norm(chart.train.latents - rest.numpy(), axis=1)
    reach = float(np.quantile(away, VISITED))
    return OperatingPoint(
        autoencoder, chart, law, compute_kinematics(autoencoder, chart), inputs, rest, reach
    )


SIZES = 81
SCALE_SPAN = 1e4


class NoScaleError(ValueError):
    """A poke that no energy scale makes the law answer as measured; the message says why."""


def compute_motion_ratio(
    answer: Float64[np.ndarray, "*B P n"], measured: Float64[np.ndarray, "P n"]
) -> Float64[np.ndarray, "*B"]:
    """How much of the measured ways an answer makes, by least squares: 1 where it is as large."""
    return np.einsum("...pc,pc->...", answer, measured) / np.sum(measured**2)


def fit_energy_scale(
    held: OperatingPoint,
    load: Float64[np.ndarray, " d"],
    jacobian: Float64[np.ndarray, "P n d"],
    measured: Float64[np.ndarray, "P n"],
) -> float:
    """The factor kappa with which the law answers ``kappa load`` by as much as was ``measured``.

    ``load`` is a known force, pulled back; ``measured`` are the ways [px] of points of the object, whose
    matter the model moves by ``jacobian``. One poke decides, and kappa is one for the whole model.

    Raises:
        NoScaleError: the answer does not grow along the measured ways, whatever the force.

    Source: paper, "Interaction and Inference", the energy factor.
    """
    direction = torch.from_numpy(load)

    def shares(sizes: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        away = (held.equilibria(torch.from_numpy(sizes)[:, None] * direction) - held.rest).numpy()
        return compute_motion_ratio(np.einsum("pcd,nd->npc", jacobian, away), measured)

    small = 1e-3 * held.visited_radius / max(float(np.linalg.norm(load)), 1e-300)
    slope = float(shares(np.array([small]))[0]) / small
    if not slope > 0.0:
        raise NoScaleError(
            "the law answers this poke against the measured way, or not at all: no energy scale makes them "
            "agree; poke another point"
        )
    sizes = np.geomspace(1.0 / np.sqrt(SCALE_SPAN), np.sqrt(SCALE_SPAN), SIZES) / slope
    found = shares(sizes)
    after = int(np.argmax(found >= 1.0))
    if after == 0:
        raise NoScaleError(
            "no energy scale within four decades makes the law answer as measured; poke softer"
        )
    low, high = np.log(np.maximum(found[after - 1 : after + 1], 1e-300))
    ratio = -low / (high - low)
    return float(np.exp(np.log(sizes[after - 1]) + ratio * np.log(sizes[after] / sizes[after - 1])))
