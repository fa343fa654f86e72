"""A baseline: encoder, decoder and one of two dynamics models, oscillators or Koopman, and its file."""

from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from itertools import pairwise
from typing import Any

import numpy as np
import torch
from jaxtyping import Float, Float64
from torch import Tensor, nn
from torch.nn import functional

from lagsplat.array_types import Images, Inputs, Latents
from lagsplat.baselines.networks import AttentionDecoder, DeconvDecoder, VariationalEncoder
from lagsplat.io.files.artifact import StrPath, load_artifact, restore_module, save_artifact

KIND, SCHEMA = "baseline", 1


@dataclass(frozen=True)
class BaselineArchitecture:
    """What decides the shape of a baseline, and the constants that its weights do not contain.

    ``decoder`` is ``deconv`` or ``abcd``, ``dynamics`` is ``oscillators`` or ``koopman``. ``n_inputs``
    counts inputs of the recording, of which the dynamics see the last ``samples``. ``dt_s`` [s] is one step.
    ``background`` and ``noise`` are of the attention decoder.
    """

    decoder: str
    dynamics: str
    d: int
    n_inputs: int
    samples: int
    height: int
    width: int
    dt_s: float
    background: float
    noise: float


class Baseline(nn.Module):
    """One of the four models, with untrained weights.

    Oscillators with an attention decoder are paired into planar nodes, one map each; with any other
    combination each coordinate has a map of its own.
    """

    def __init__(self, architecture: BaselineArchitecture) -> None:
        super().__init__()
        self.architecture = of = architecture
        size = {"height": of.height, "width": of.width}
        paired = (of.decoder, of.dynamics) == ("abcd", "oscillators")
        self.encoder = VariationalEncoder(of.d, **size)
        self.decoder: AttentionDecoder | DeconvDecoder
        if of.decoder == "abcd":
            group = 2 if paired else 1
            self.decoder = AttentionDecoder(
                of.d, group=group, **size, background=of.background, noise=of.noise
            )
        else:
            self.decoder = DeconvDecoder(of.d, **size)
        self.dynamics: Oscillators | Koopman
        n_fed = of.samples * of.n_inputs
        if of.dynamics == "oscillators":
            self.dynamics = Oscillators(of.d, n_inputs=n_fed, dt_s=of.dt_s, paired=paired)
        else:
            self.dynamics = Koopman(of.d, n_inputs=n_fed)
        for part in (self.encoder, self.decoder):
            part.apply(_xavier)

    def rollout(
        self, z: Latents, v: Latents, inputs: Float[Tensor, "B N n_u"]
    ) -> tuple[Float[Tensor, "B N d"], Float[Tensor, "B N d"]]:
        """States and velocities at ``N`` frames, the first as given, under delayed ``inputs``.

        Input ``i`` leads from state ``i`` to ``i + 1``; the last one is unused. No later frame is used.
        """
        states, velocities = [z], [v]
        for i in range(inputs.shape[1] - 1):
            z, v = self.dynamics(z, v, inputs[:, i])
            states.append(z)
            velocities.append(v)
        return torch.stack(states, 1), torch.stack(velocities, 1)

    def decode(self, z: Latents) -> Images:
        """Images in [0, 1], without the noise of training."""
        return self.decoder(z)


def _xavier(module: nn.Module) -> None:
    if isinstance(module, nn.Linear | nn.Conv2d | nn.ConvTranspose2d):
        nn.init.xavier_uniform_(module.weight)
        if module.bias is not None:
            nn.init.zeros_(module.bias)


def save_baseline(path: StrPath, baseline: Baseline, header: Mapping[str, Any]) -> None:
    """Write the weights and the architecture."""
    header = {"kind": KIND, "schema": SCHEMA, **header, "architecture": asdict(baseline.architecture)}
    save_artifact(path, baseline.state_dict(), header)


def load_baseline(path: StrPath) -> tuple[Baseline, dict[str, Any]]:
    """Read a baseline and its header; errors as `lagsplat.io.files.artifact.load_artifact`."""
    tensors, header = load_artifact(path, kind=KIND, schema=SCHEMA)
    baseline = Baseline(BaselineArchitecture(**header["architecture"]))
    return restore_module(baseline, tensors, path), header


KOOPMAN_WIDTH = 16


class Koopman(nn.Module):
    """``y -> A y + h(u)`` on ``y = (z, v)``, once a frame.

    ``v`` is not tied to the derivative of ``z``, and there is no force: what is added to ``y`` is an
    increment of the state without a mechanical interpretation.
    """

    def __init__(self, d: int, *, n_inputs: int) -> None:
        super().__init__()
        self.d = d
        self.matrix = nn.Parameter(torch.eye(2 * d))
        self.increment = nn.ModuleList([nn.Linear(n_inputs, KOOPMAN_WIDTH), nn.Linear(KOOPMAN_WIDTH, 2 * d)])

    def input_force(self, u: Inputs) -> Float[Tensor, "B n"]:
        """``h(u)`` of the delayed inputs, n = 2 d."""
        first, last = self.increment
        return last(functional.leaky_relu(first(u)))

    def forward(self, z: Latents, v: Latents, u: Inputs) -> tuple[Latents, Latents]:
        """State and the second half of ``y`` one frame later."""
        later = torch.cat([z, v], 1) @ self.matrix.T + self.input_force(u)
        return later[:, : self.d], later[:, self.d :]

    def transition(self) -> Float[Tensor, "n n"]:
        """The matrix ``A``, n = 2 d."""
        return self.matrix


OSCILLATOR_WIDTH = 32
UNDECAYED = ("mass_scale", "stiffness_scale", "mass_damping", "stiffness_damping")
"""Parameters without weight decay, because they are logarithms."""


class Oscillators(nn.Module):
    """``M z'' + D z' + K (z - rest) = g(u)``, with a diagonal ``M`` and Rayleigh damping.

    ``K`` is a weighted graph Laplacian of attractive springs, plus springs to the ground, and ``D = a M + b
    K``. Coordinates are scalars with their rest at zero or, if ``paired``, planar positions of nodes, two
    coordinates each, that share a mass and have a learned rest.
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
        self.force = nn.ModuleList(
            nn.Linear(a, b) for a, b in pairwise((n_inputs, OSCILLATOR_WIDTH, OSCILLATOR_WIDTH, d))
        )

    def inverse_mass(self) -> Float[Tensor, " d"]:
        """The diagonal of ``M^-1``."""
        entries = functional.softplus(self.inverse_mass_raw) * self.mass_scale.exp()
        return entries.repeat_interleave(2) if self.paired else entries

    def stiffness(self) -> Float[Tensor, "d d"]:
        """The stiffness ``K``: symmetric and positive definite."""
        spring = functional.softplus(self.coupling_raw)
        spring = 0.5 * (spring + spring.T)
        spring = spring - spring.diag().diag()
        ground = functional.softplus(self.ground_raw)
        return self.stiffness_scale.exp() * ((spring.sum(1) + ground).diag() - spring)

    def damping(self) -> Float[Tensor, "d d"]:
        """The damping ``D``, proportional to mass and to stiffness."""
        mass = (1.0 / self.inverse_mass()).diag()
        return self.mass_damping.exp() * mass + self.stiffness_damping.exp() * self.stiffness()

    def input_force(self, u: Inputs) -> Latents:
        """The force ``g(u)`` of the delayed inputs."""
        value: Tensor = u
        for number, layer in enumerate(self.force):
            value = layer(functional.leaky_relu(value) if number else value)
        return value

    def forward(
        self, z: Latents, v: Latents, u: Inputs, push: Latents | None = None
    ) -> tuple[Latents, Latents]:
        """State and velocity [1/s] one frame later; ``push`` is a further force on the coordinates."""
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


def stack_delays(
    inputs: Float64[np.ndarray, "T c"], *, samples: int, segments: Sequence[tuple[int, int]]
) -> Float64[np.ndarray, "T m"]:
    """The last ``samples`` inputs of each frame, oldest first, m = samples c; channels stay together.

    Before the start of a clip its first input is repeated. Delays are made on the whole recording, so that
    the first held-out frame has its past inputs.
    """
    rows = np.empty((len(inputs), samples * inputs.shape[1]))
    for start, stop in segments:
        frames = np.arange(start, stop)
        past = [inputs[np.maximum(frames - back, start)] for back in range(samples - 1, -1, -1)]
        rows[start:stop] = np.concatenate(past, axis=1)
    return rows
