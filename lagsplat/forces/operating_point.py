"""A run at rest, ready to be pushed, and its energy scale.

`fit_energy_scale` finds the number that a video cannot show: how much energy of the law is a joule.
"""

from dataclasses import dataclass

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor

from lagsplat.array_types import Latent, Latents
from lagsplat.chart.chart import Chart
from lagsplat.forces.grasp import GraspPoint, Place, Point, grasp_brush
from lagsplat.forces.loaded_lagrangian import find_loaded_equilibria, rollout_under_force
from lagsplat.forces.loads import Load, PointLoad, make_no_load
from lagsplat.forces.moving_parts import MovingParts, find_moving_parts
from lagsplat.matter.field import MaterialPoints, MatterField
from lagsplat.splat.projection import View
from lagsplat.stage1.autoencoder import Autoencoder
from lagsplat.stage2.equilibrium import find_equilibrium
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.views.camera import project_by_lens

VISITED = 0.99  # quantile of the distances of the training states from rest that gives the visited radius
MAGNITUDES = 60  # forces among which the requested one is interpolated
SPAN = 1e4  # ratio of the largest to the smallest of these forces
STILL = 1e-6  # share of the largest Jacobian below which matter does not move


@dataclass(frozen=True)
class OperatingPoint:
    """A law at rest in the state ``rest`` (d,) under the constant inputs ``u`` (n_u,).

    ``matter`` says what can be pushed and how it moves. ``visited_radius`` [whitened units] is the 99th
    percentile of the distances of training states from rest.

    Example:
        >>> import lagsplat
        >>> point = lagsplat.hold("run")
        >>> point.rest.shape
        torch.Size([2])
    """

    autoencoder: Autoencoder
    chart: Chart
    law: Lagrangian
    matter: MatterField
    u: Float[Tensor, " n_u"]
    rest: Latent
    visited_radius: float

    @property
    def height(self) -> int:
        """Height of the image [px]."""
        return self.autoencoder.height

    @property
    def width(self) -> int:
        """Width of the image [px]."""
        return self.autoencoder.width

    def grasp(self, at: Point | Place, *, radius: float) -> GraspPoint:
        """Grasp what is under a brush of ``radius`` [px] at rest; errors as `grasp_brush`."""
        return grasp_brush(self.matter, self.rest, at, radius=radius, size=(self.height, self.width))

    def find_moving_parts(self) -> MovingParts:
        """Find the matter that each pixel of the recording camera shows at rest."""
        size = {"height": self.height, "width": self.width}
        return find_moving_parts(self.matter, self.rest, lens=self.autoencoder.lens, **size)

    def equilibria(self, load: Load) -> Latents:
        """Find the equilibria under a load, one per row."""
        return find_loaded_equilibria(self.law, self.u.expand(len(load), -1), load, start=self.rest)

    def render_images(
        self, q: Latents, *, scale: int = 1, view: View | None = None
    ) -> Float[np.ndarray, "B H W 3"]:
        """Draw whitened states, ``scale`` times as large as in training; in space from any camera."""
        raw = torch.from_numpy(self.chart.to_raw(q.numpy())).to(self.autoencoder.gaussians.center)
        height, width = scale * self.height, scale * self.width
        with torch.no_grad():
            drawn = self.autoencoder.decode(raw, view=view, height=height, width=width)
        return np.moveaxis(drawn.cpu().numpy(), 1, 3)

    def find_force_size(
        self, grasp: GraspPoint, direction: Float64[np.ndarray, " n"], *, share: float
    ) -> float:
        """Find the force along ``direction`` that moves the state by ``share`` of the visited radius.

        The force [energy of the law per px] is interpolated among forces within four decades around the
        linear estimate from the stiffness at rest; it is the least one.

        Raises:
            ValueError: the matter there does not move along ``direction``, or never so far.
        """
        unit = torch.from_numpy(direction)
        felt = float(grasp.pull_back(unit, self.rest).norm())
        if not felt > STILL * float(self.matter.jacobian(self.rest).abs().max()):
            where = f"moves nothing at {grasp.at.tolist()}"
            raise ValueError(f"a force along {direction.tolist()} {where}; choose another point or direction")
        small = 1e-3 * self.visited_radius / felt
        linear = share * self.visited_radius * small / float(self._answer(grasp, small * unit[None])[0])
        sizes = torch.from_numpy(np.geomspace(linear / np.sqrt(SPAN), linear * np.sqrt(SPAN), MAGNITUDES))
        away = np.maximum.accumulate(self._answer(grasp, sizes[:, None] * unit).numpy()) / self.visited_radius
        if away[-1] < share:
            raise ValueError(
                f"no force along {direction.tolist()} at {grasp.at.tolist()} moves the state by {share:.0%} "
                f"of the visited radius: it goes {away[-1]:.0%} at most; choose another point or direction"
            )
        return float(np.exp(np.interp(np.log(share), np.log(away), sizes.log().numpy())))

    def push(
        self,
        grasp: GraspPoint,
        direction: Float64[np.ndarray, " n"],
        *,
        share: float,
        hold_s: float,
        duration_s: float,
    ) -> tuple[Float[Tensor, "N d"], Float[Tensor, "N d"]]:
        """Push what is grasped for ``hold_s`` [s], let go, and follow states and velocities [1/s].

        They are a frame of the recording apart. The force is the least constant one along ``direction`` that
        moves the state at rest by ``share`` of the visited radius.

        Raises:
            ValueError: as `find_force_size`.
        """
        unit = direction / np.linalg.norm(direction)
        force = torch.from_numpy(self.find_force_size(grasp, unit, share=share) * unit)
        dt_s, nothing, rest = self.chart.dt_s, make_no_load(self.law.d), self.rest[None]
        n, held = round(duration_s / dt_s), round(hold_s / dt_s)
        pushed = PointLoad(grasp.points, force[None])
        loads: list[Load] = [pushed if i < held else nothing for i in range(n)]
        inputs = self.u.expand(1, n + 1, -1)
        q, v = rollout_under_force(self.law, rest, torch.zeros_like(rest), inputs, loads, dt_s=dt_s)
        return q[0], v[0]

    def find_lever(self) -> tuple[tuple[float, float], tuple[float, float]]:
        """The point of the image [px] that moves most with the state, and the unit vector of its motion.

        It points towards the middle of the image.
        """
        parts = self.find_moving_parts()
        moves = np.where(parts.inner[:, :, None, None], parts.jacobian[:, :, :2], 0.0)
        across, size, _ = np.linalg.svd(moves, full_matrices=False)
        row, column = np.unravel_index(int(size[:, :, 0].argmax()), size.shape[:2])
        at, along = np.array([column + 0.5, row + 0.5]), across[row, column, :, 0]
        inwards = np.array([self.width, self.height]) / 2.0 - at
        right, down = (np.copysign(1.0, inwards @ along) * along).tolist()
        return (float(at[0]), float(at[1])), (right, down)

    def follow_matter_at(
        self, pixel: tuple[float, float], q: Float64[np.ndarray, " d"]
    ) -> Float64[np.ndarray, " n"]:
        """Where the matter is at a state that is seen in a pixel at rest [px; in space, px at the pivot]."""
        at_rest, now = self.matter.carry(torch.stack([self.rest, torch.from_numpy(q)])).numpy()
        lens = self.autoencoder.lens
        seen = at_rest if lens is None else project_by_lens(at_rest, lens)
        return now[int(np.linalg.norm(seen - np.array(pixel), axis=1).argmin())]

    def _answer(self, grasp: GraspPoint, forces: Float[Tensor, "B n"]) -> Float[Tensor, " B"]:
        """Distances from rest under forces on a grasped point [whitened units]."""
        return (self.equilibria(PointLoad(grasp.points, forces)) - self.rest).norm(dim=1)


def hold_at_load(
    autoencoder: Autoencoder,
    chart: Chart,
    law: Lagrangian,
    matter: MatterField,
    u: Float64[np.ndarray, " n_u"] | None = None,
) -> OperatingPoint:
    """Hold a run at rest under constant inputs ``u``, by default the mean of the training inputs.

    Raises:
        NoEquilibriumError: none was found.
    """
    inputs = torch.from_numpy(chart.train.inputs.mean(0) if u is None else u)
    rest = find_equilibrium(law, inputs)
    away = np.linalg.norm(chart.train.latents - rest.numpy(), axis=1)
    reach = float(np.quantile(away, VISITED))
    return OperatingPoint(autoencoder, chart, law, matter, inputs, rest, reach)


SIZES = 81  # energy scales among which the answer is interpolated
SCALE_SPAN = 1e4  # ratio of the largest to the smallest of these scales


class NoScaleError(ValueError):
    """No energy scale makes the response of the law match a measured push; the message says why."""


def fit_energy_scale(
    operating_point: OperatingPoint,
    push: PointLoad,
    observed: MaterialPoints,
    measured: Float64[np.ndarray, "P n"],
) -> float:
    """Fit the factor kappa with which the response to ``kappa push`` matches measured displacements.

    One push decides; kappa holds for the whole model.

    Args:
        operating_point: at which it was pushed.
        push: one force, in the unit of the measurement.
        observed: points whose displacements from rest were measured.
        measured: these displacements [px].

    Raises:
        NoScaleError: the response does not grow along the measured displacements.

    Source: paper, "Interaction and Inference", the energy factor.
    """
    still = observed.carry(operating_point.rest[None])

    def motion_ratios(sizes: Float64[np.ndarray, " n"]) -> Float64[np.ndarray, " n"]:
        """Least-squares ratios of the responses to the measured displacements; 1 where they agree."""
        load = PointLoad(push.points, torch.from_numpy(sizes)[:, None] * push.force)
        answer = (observed.carry(operating_point.equilibria(load)) - still).numpy()
        return np.einsum("npc,pc->n", answer, measured) / np.sum(measured**2)

    felt = float(push.generalise(operating_point.rest[None]).norm())
    small = 1e-3 * operating_point.visited_radius / max(felt, 1e-300)
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
