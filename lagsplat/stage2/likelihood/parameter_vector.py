"""The free parameters of a polynomial law as one vector, with rollouts and their derivatives."""

import numpy as np
import torch
from jaxtyping import Float, Int
from torch import Tensor

from lagsplat.monomials import evaluate_monomials
from lagsplat.stage2 import polynomial_kernels
from lagsplat.stage2.lagrangian import Lagrangian
from lagsplat.stage2.likelihood.windows import Windows
from lagsplat.stage2.polynomials import LOADS, SPRINGS, list_law_arrays

States = Float[Tensor, "K s"]  # position and velocity [per internal time unit] in the coordinates of the law
Paths = Float[Tensor, "K n s"]

MAP = "coordinates.coefficients"
FRAME = "mass_term.frame.coefficients"
POTENTIAL, VOLUMES = "energy.coefficients", "energy.input_coefficients"
KERNEL_ORDER = ("mass_term.factor", FRAME, "damping_term.factor", POTENTIAL, VOLUMES)


class ParameterVector:
    """The free parameters of a polynomial law as one vector, and rollouts as a function of it."""

    def __init__(self, lagrangian: Lagrangian) -> None:
        assert lagrangian.coordinates is not None
        self.lagrangian, self.terms = lagrangian, lagrangian.polynomials
        self.coordinates = lagrangian.coordinates
        self.parts = {name: p for name, p in lagrangian.named_parameters() if p.requires_grad}
        assert tuple(self.parts) == (MAP, *KERNEL_ORDER)

    def read(self) -> Float[Tensor, " p"]:
        """The parameters as they are."""
        return torch.cat([p.detach().reshape(-1) for p in self.parts.values()])

    def write(self, theta: Float[Tensor, " p"]) -> None:
        """Set the parameters of the law."""
        with torch.no_grad():
            for parameter, value in zip(self.parts.values(), self._split(theta).values(), strict=True):
                parameter.copy_(value)

    def find_columns(self, *names: str) -> Int[Tensor, " n"]:
        """Places of some parts in the vector, part by part."""
        sizes = [p.numel() for p in self.parts.values()]
        first = dict(zip(self.parts, np.cumsum([0, *sizes[:-1]]).tolist(), strict=True))
        return torch.cat([first[name] + torch.arange(self.parts[name].numel()) for name in names])

    def list_groups(self) -> dict[str, Int[Tensor, " n"]]:
        """Places of the terms that a linear law has not: of the map, the frame, V and nu."""
        energy, _, _ = self.terms
        every = torch.tensor(True)
        above = {
            MAP: every,
            FRAME: every,
            POTENTIAL: energy.exponents.sum(1) > SPRINGS,
            VOLUMES: energy.input_exponents.sum(1) > LOADS,
        }
        groups = {
            name: self.find_columns(name)[each.expand_as(self.parts[name]).reshape(-1)]
            for name, each in above.items()
        }
        return {name: group for name, group in groups.items() if len(group)}

    def scale_direction(self) -> Float[Tensor, " p"]:
        """How the parameters move when all energies and forces grow alike, which no motion shows."""
        shares = {"coefficients": 1.0, "input_coefficients": 1.0, "factor": 0.5}
        rows = []
        for name, p in self.parts.items():
            of_energy = name.startswith("energy.") or name.endswith("factor")
            rows.append(shares[name.split(".")[-1]] * of_energy * p.detach().reshape(-1))
        return torch.cat(rows)

    @torch.no_grad()
    def roll_out(self, theta: Float[Tensor, " p"], starts: States, windows: Windows) -> Paths:
        """States of all windows, the start included; leaves the law at ``theta``."""
        self.write(theta)
        return torch.from_numpy(
            polynomial_kernels.roll_out(
                list_law_arrays(*self.terms), starts.numpy(), windows.inputs.numpy(), windows.steps.numpy()
            )
        )

    @torch.no_grad()
    def observe(
        self, theta: Float[Tensor, " p"], x: Float[Tensor, "K n d"], near: Float[Tensor, "K n d"]
    ) -> Float[Tensor, "K n d"]:
        """Latents at positions in the coordinates of the law, first guessed; leaves the law at ``theta``."""
        self.write(theta)
        return self.coordinates.invert(x.flatten(0, 1), near.flatten(0, 1)).view(x.shape)

    @torch.no_grad()
    def differentiate_observation(
        self, theta: Float[Tensor, " p"], q: Float[Tensor, "K n d"]
    ) -> tuple[Float[Tensor, "K n d d"], Float[Tensor, "K n d m"]]:
        """Derivatives of the latents ``q`` by the position and by the coefficients of the map."""
        self.write(theta)
        flat, shape = q.flatten(0, 1), q.shape
        value, _ = evaluate_monomials(flat, self.coordinates.exponents, ball=self.coordinates.ball)
        inverse = torch.linalg.inv(self.coordinates.evaluate(flat)[1])
        by_map = -torch.einsum("bij,bk->bikj", inverse, value)
        return inverse.view(*shape, -1), by_map.reshape(*shape, -1)

    @torch.no_grad()
    def differentiate(
        self, theta: Float[Tensor, " p"], path: Paths, windows: Windows
    ) -> tuple[Float[Tensor, "K m s s"], Float[Tensor, "K n d k"], Float[Tensor, "K s k"]]:
        """Derivatives of the states by the start of their window, and by all parameters but the map's.

        The latter are those of every position but the last, and of the last state.
        """
        self.write(theta)
        transition, by_law, last = polynomial_kernels.differentiate_path(
            list_law_arrays(*self.terms), path.numpy(), windows.inputs.numpy(), windows.steps.numpy()
        )
        return torch.from_numpy(transition), torch.from_numpy(by_law), torch.from_numpy(last)

    def _split(self, theta: Tensor) -> dict[str, Tensor]:
        pieces = theta.split([p.numel() for p in self.parts.values()])
        return {name: x.view(p.shape) for (name, p), x in zip(self.parts.items(), pieces, strict=True)}
