"""A network of coupled, damped oscillators with a learned force, one symplectic step a frame."""

from itertools import pairwise

import torch
from jaxtyping import Float
from torch import Tensor, nn
from torch.nn import functional

from lagsplat.shapes import Inputs, Latents

HIDDEN = 32
UNDECAYED = ("mass_scale", "stiffness_scale", "mass_damping", "stiffness_damping")
"""Parameters that weight decay must not pull towards zero: they are logarithms."""


class Oscillators(nn.Module):
    """``M z'' + D z' + K (z - rest) = g(u)``, with a diagonal ``M`` and Rayleigh damping.

    ``K`` is a weighted graph Laplacian of springs that only attract, plus springs to the ground, and
    ``D = a M + b K``. Coordinates are numbers on a line with their rest at zero; or, ``paired``, planar
    positions of nodes, two coordinates each, that share a mass and have a learned rest.
    """

    def __init__(self, d: int, *, n_inputs: int, dt_s: float, paired: bool) -> None:
        super().__init__()
        self.d, self.dt_s, self.paired = d, dt_s, paired
        self.inverse_mass_raw = nn.Parameter(torch.ones(d // 2 if paired else d))
        self.mass_scale = nn.Parameter(torch.ones(1))
        self.stiffness_scale = nn.Parameter(torch.ones(1))
        self.coupling_raw = nn.Parameter(nn.init.xavier_uniform_(torch.empty(d, d)))
        self.ground_raw = nn.Parameter(torch.zeros(d))
        self.mass_damping = nn.Parameter(torch.zeros(1))
        self.stiffness_damping = nn.Parameter(torch.zeros(1))
        if paired:
            self.rest = nn.Parameter(torch.zeros(d))
        else:
            self.register_buffer("rest", torch.zeros(d), persistent=False)
        self.force = nn.ModuleList(nn.Linear(a, b) for a, b in pairwise((n_inputs, HIDDEN, HIDDEN, d)))

    def inverse_mass(self) -> Float[Tensor, " d"]:
        """The diagonal of ``M^-1``."""
        entries = functional.softplus(self.inverse_mass_raw) * self.mass_scale.exp()
        return entries.repeat_interleave(2) if self.paired else entries

    def stiffness(self) -> Float[Tensor, "d d"]:
        """``K``: symmetric and positive definite."""
        spring = functional.softplus(self.coupling_raw)
        spring = 0.5 * (spring + spring.T)
        spring = spring - spring.diag().diag()
        ground = functional.softplus(self.ground_raw)
        return self.stiffness_scale.exp() * ((spring.sum(1) + ground).diag() - spring)

    def damping(self) -> Float[Tensor, "d d"]:
        """``D``: mass damping of the inverse mass's reciprocal, and stiffness damping."""
        mass = (1.0 / self.inverse_mass()).diag()
        return self.mass_damping.exp() * mass + self.stiffness_damping.exp() * self.stiffness()

    def input_force(self, u: Inputs) -> Latents:
        """``g(u)``, of the delayed inputs."""
        value: Tensor = u
        for number, layer in enumerate(self.force):
            value = layer(functional.leaky_relu(value) if number else value)
        return value

    def forward(
        self, z: Latents, v: Latents, u: Inputs, push: Latents | None = None
    ) -> tuple[Latents, Latents]:
        """State and velocity [1/s] a frame later; ``push`` is a further force on the coordinates."""
        force = self.input_force(u) - (z - self.rest) @ self.stiffness() - v @ self.damping().T
        if push is not None:
            force = force + push
        later = v + self.dt_s * self.inverse_mass() * force
        return z + self.dt_s * later, later

    def transition(self) -> Float[Tensor, "n n"]:
        """The step as a matrix on (z, v), n = 2 d, about the rest and without force."""
        eye = torch.eye(self.d, dtype=self.inverse_mass_raw.dtype)
        per_s = self.dt_s * self.inverse_mass()[:, None]
        kick = torch.cat([-per_s * self.stiffness(), eye - per_s * self.damping()], 1)
        return torch.cat([torch.cat([eye, 0.0 * eye], 1) + self.dt_s * kick, kick], 0)
