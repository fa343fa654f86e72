"""Equilibria of a law under constant inputs and loads: the minima of ``V - u.nu - load.q``.

`OperatingPoint` is a run at rest, ready to be pushed. `fit_energy_scale` finds the number that a video cannot
show: how much energy of the law is a joule.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Bool, Float, Float64
from torch import Tensor

from lagsplat.array_types import Inputs, Latent, Latents, Spd
from lagsplat.chart.chart import Chart
from lagsplat.forces.grasp import GraspPoint, MatterKinematics, compute_kinematics
from lagsplat.forces.loaded_lagrangian import LoadedLagrangian
from lagsplat.splat.projection import View
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage2.lagrangian import UNTOUCHED, Lagrangian, LawEdits, PreparedCoefficients

ITERATIONS = 200
TOLERANCE = 1e-10  # largest remaining force, relative to the load plus the stiffness at the start
LEAST_CURVATURE = 1e-6  # smallest curvature in a Newton step, relative to the largest
DECREASE = 1e-4  # Armijo's constant: share of the predicted decrease that a step must reach
UNRESOLVED = 1e-12  # predicted decrease, relative to 1 plus the energy, that rounding hides: a step is taken
SHORTEST = 2.0**-40  # smallest factor on a Newton step


@torch.no_grad()
def settle(
    law: Lagrangian, u: Inputs, load: Latents, *, edits: LawEdits = UNTOUCHED, start: Latent | None = None
) -> Latents:
    """Find the equilibria (B, d) under inputs ``u`` and generalised forces ``load``, one per row.

    Newton's method on the energy. Where its Hessian is not positive definite, eigenvalues are replaced by
    their absolute value, so that every step descends; a step is halved until the energy falls by Armijo's
    rule. The quadratic floor of ``V`` outgrows the linear work of a load, so lower level sets of the energy
    are compact and every limit point is stationary for any network and load. ``start`` is the first state of
    the iteration, by default the rest state of the law.

    Raises:
        ValueError: a load is not finite, energies overflow under it, or the iterations do not suffice.

    Source: paper, Appendix "Bounded forced response"; Nocedal and Wright, Numerical Optimization, ch. 3.
    """
    loaded = LoadedLagrangian(law, load, edits=edits)
    first = law.rest.detach() if start is None else start
    q = first.expand(len(load), -1).clone()
    ready = loaded.prepare()
    force, hessian = _slopes(loaded, q, u, ready)
    scale = load.norm(dim=1) + hessian.abs().amax((1, 2))
    for _ in range(ITERATIONS if bool(torch.isfinite(scale).all()) else 0):
        moving = ~(force.norm(dim=1) <= TOLERANCE * scale)  # true for NaN, too
        if not bool(moving.any()):
            # One more Newton step where it lowers the force: responses are small differences of equilibria.
            closer = q + torch.linalg.solve_ex(hessian, force[:, :, None])[0][:, :, 0]
            remaining = loaded.conservative_force(closer, u, ready).norm(dim=1)
            return torch.where((remaining < force.norm(dim=1))[:, None], closer, q)
        q = torch.where(moving[:, None], _descend(loaded, q, u, force, hessian), q)
        force, hessian = _slopes(loaded, q, u, ready)
    left = force.norm(dim=1) / scale
    worst = int(left.nan_to_num(torch.inf).argmax())
    raise ValueError(
        f"no equilibrium was reached in {ITERATIONS} steps under the load {load[worst].tolist()}: "
        f"{float(left[worst]):.1e} of the force is left at q = {q[worst].tolist()}; lower the force, or "
        "look at the law's potential"
    )


def compute_loaded_energy(law: Lagrangian, q: Latents, u: Inputs) -> Float[Tensor, " B"]:
    """``V - u.nu``, less the work of the load if there is one."""
    return law.potential(q) - (law.volume(q, u) * u).sum(1)


def compute_static_stiffness(law: Lagrangian, q: Latents, u: Inputs) -> Float[Tensor, "B d d"]:
    """The symmetric Hessian of the energy at ``q``."""
    return _slopes(law, q, u, law.prepare())[1]


def _slopes(law: Lagrangian, q: Latents, u: Inputs, ready: PreparedCoefficients) -> tuple[Latents, Spd]:
    """The force at ``q`` and the symmetric Hessian of the energy."""
    with torch.enable_grad():
        point = q.detach().requires_grad_()
        force = law.conservative_force(point, u, ready)
        rows = [torch.autograd.grad(part.sum(), point, retain_graph=True)[0] for part in force.unbind(1)]
    hessian = -torch.stack(rows, 1).detach()
    return force.detach(), 0.5 * (hessian + hessian.mT)


def _descend(law: Lagrangian, q: Latents, u: Inputs, force: Latents, hessian: Spd) -> Latents:
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


VISITED = 0.99  # quantile of the distances of the training states from rest that gives the visited radius
MAGNITUDES = 60  # forces among which the requested one is interpolated
SPAN = 1e4  # ratio of the largest to the smallest of these forces
STILL = 1e-6  # share of the largest Jacobian below which matter does not move


@dataclass(frozen=True)
class OperatingPoint:
    """A law at rest in the state ``rest`` (d,) under the constant inputs ``u`` (n_u,).

    ``visited_radius`` [whitened units] is the 99th percentile of the distances of training states from rest.

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
    rest: Latent
    visited_radius: float

    def equilibria(self, loads: Latents) -> Latents:
        """Find the equilibria under generalised forces, one per row."""
        return settle(self.law, self.u.expand(len(loads), -1), loads, start=self.rest)

    def render_images(
        self, q: Latents, *, scale: int = 1, view: View | None = None
    ) -> Float[np.ndarray, "B H W 3"]:
        """Draw whitened states, ``scale`` times as large as in training; in space from any camera."""
        raw = torch.from_numpy(self.chart.to_raw(q.numpy())).to(self.autoencoder.gaussians.center)
        height, width = scale * self.kinematics.height, scale * self.kinematics.width
        with torch.no_grad():
            drawn = self.autoencoder.decode(raw, view=view, height=height, width=width)
        return np.moveaxis(drawn.cpu().numpy(), 1, 3)

    def find_force_size(
        self, grasp_point: GraspPoint, direction: Float64[np.ndarray, " n"], *, share: float
    ) -> float:
        """Find the force along ``direction`` that moves the state by ``share`` of the visited radius.

        The force [energy of the law per px] is interpolated among forces within four decades around the
        linear estimate from the stiffness at rest.

        Raises:
            ValueError: the matter there does not move along ``direction``.
        """
        unit = grasp_point.pull_back(torch.from_numpy(direction))
        if not float(unit.norm()) > STILL * float(self.kinematics.geometry.jacobian.abs().max()):
            where = f"moves nothing at {grasp_point.at.tolist()}"
            raise ValueError(f"a force along {direction.tolist()} {where}; choose another point or direction")
        small = 1e-3 * self.visited_radius / float(unit.norm())
        answer = float((self.equilibria(small * unit[None])[0] - self.rest).norm())
        linear = share * self.visited_radius * small / answer
        sizes = torch.from_numpy(np.geomspace(linear / np.sqrt(SPAN), linear * np.sqrt(SPAN), MAGNITUDES))
        away = (self.equilibria(sizes[:, None] * unit) - self.rest).norm(dim=1) / self.visited_radius
        return float(np.exp(np.interp(np.log(share), away.log().numpy(), sizes.log().numpy())))


def hold_at_load(
    autoencoder: Autoencoder, chart: Chart, law: Lagrangian, u: Float64[np.ndarray, " n_u"] | None = None
) -> OperatingPoint:
    """Hold a run at rest under constant inputs ``u``, by default the mean of the training inputs."""
    inputs = torch.from_numpy(chart.train.inputs.mean(0) if u is None else u)
    rest = settle(law, inputs[None], torch.zeros(1, law.d, dtype=torch.float64))[0]
    away = np.linalg.norm(chart.train.latents - rest.numpy(), axis=1)
    kinematics, reach = compute_kinematics(autoencoder, chart), float(np.quantile(away, VISITED))
    return OperatingPoint(autoencoder, chart, law, kinematics, inputs, rest, reach)


SIZES = 81  # energy scales among which the answer is interpolated
SCALE_SPAN = 1e4  # ratio of the largest to the smallest of these scales


class NoScaleError(ValueError):
    """No energy scale makes the response of the law match a measured push; the message says why."""


def fit_energy_scale(
    operating_point: OperatingPoint,
    load: Float64[np.ndarray, " d"],
    jacobian: Float64[np.ndarray, "P n d"],
    measured: Float64[np.ndarray, "P n"],
) -> float:
    """Fit the factor kappa with which the response to ``kappa load`` matches ``measured`` displacements [px].

    One push decides; kappa holds for the whole model. ``jacobian`` [px per whitened unit] is of the observed
    points.

    Raises:
        NoScaleError: the response does not grow along the measured displacements.

    Source: paper, "Interaction and Inference", the energy factor.
    """
    direction = torch.from_numpy(load)

    def motion_ratios(sizes: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """Least-squares ratios of the responses to the measured displacements; 1 where they agree."""
        states = operating_point.equilibria(torch.from_numpy(sizes)[:, None] * direction)
        answer = np.einsum("pcd,nd->npc", jacobian, (states - operating_point.rest).numpy())
        return np.einsum("...pc,pc->...", answer, measured) / np.sum(measured**2)

    small = 1e-3 * operating_point.visited_radius / max(float(np.linalg.norm(load)), 1e-300)
    slope = float(motion_ratios(np.array([small]))[0]) / small
    if not slope > 0.0:
        raise NoScaleError("the law moves against the measured displacement, or not at all; push elsewhere")
    sizes = np.geomspace(1.0 / np.sqrt(SCALE_SPAN), np.sqrt(SCALE_SPAN), SIZES) / slope
    ratios = motion_ratios(sizes)
    after = int(np.argmax(ratios >= 1.0))
    if after == 0:
        raise NoScaleError("no energy scale within four decades agrees with the push; push with less force")
    low, high = np.log(np.maximum(ratios[after - 1 : after + 1], 1e-300))
    ratio = -low / (high - low)
    return float(np.exp(np.log(sizes[after - 1]) + ratio * np.log(sizes[after] / sizes[after - 1])))
