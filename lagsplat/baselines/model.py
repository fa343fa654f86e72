"""One baseline: encoder, decoder and law of motion, and its file."""

import os
from collections.abc import Mapping
from dataclasses import asdict, dataclass
from typing import Any

import torch
from jaxtyping import Float
from torch import Tensor, nn

from lagsplat.baselines.abcd import AttentionDecoder
from lagsplat.baselines.deconv import DeconvDecoder
from lagsplat.baselines.encoder import VariationalEncoder
from lagsplat.baselines.koopman import Koopman
from lagsplat.baselines.oscillators import Oscillators
from lagsplat.io.artefact import load_artefact, save_artefact
from lagsplat.io.restore import restore
from lagsplat.shapes import Images, Inputs, Latents

KIND, SCHEMA = "baseline", 1


@dataclass(frozen=True)
class Architecture:
    """What decides the shape of a baseline, and what of its behaviour no list of weights holds.

    ``decoder`` is ``deconv`` or ``abcd``, ``dynamics`` is ``oscillators`` or ``koopman``. ``n_inputs`` counts
    inputs of the recording, of which the law is fed the last ``samples``. ``dt_s`` [s] is one step.
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
    """One of the four models, with weights as they are before training.

    Decoder and law meet in one place: oscillators that are drawn by attention are paired into planar nodes,
    one map each; any other law has one map a coordinate.
    """

    def __init__(self, architecture: Architecture) -> None:
        super().__init__()
        self.architecture = architecture
        of = architecture
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
        self, z0: Latents, v0: Latents, inputs: Float[Tensor, "B N n_u"]
    ) -> tuple[Float[Tensor, "B N d"], Float[Tensor, "B N d"]]:
        """States and velocities at ``N`` frames, the first as given, under delayed ``inputs``.

        Input ``i`` leads from state ``i`` to ``i + 1``; the last one is unused. Nothing is anchored again.
        """
        z, v = z0, v0
        states, velocities = [z], [v]
        for i in range(inputs.shape[1] - 1):
            z, v = self.dynamics(z, v, inputs[:, i])
            states.append(z)
            velocities.append(v)
        return torch.stack(states, 1), torch.stack(velocities, 1)

    def step(self, z: Latents, v: Latents, u: Inputs) -> tuple[Latents, Latents]:
        """State and velocity a frame later."""
        return self.dynamics(z, v, u)

    def decode(self, z: Latents) -> Images:
        """Images in [0, 1], without the noise of training."""
        return self.decoder(z)


def _xavier(module: nn.Module) -> None:
    if isinstance(module, nn.Linear | nn.Conv2d | nn.ConvTranspose2d):
        nn.init.xavier_uniform_(module.weight)
        if module.bias is not None:
            nn.init.zeros_(module.bias)


def save_baseline(path: str | os.PathLike[str], baseline: Baseline, header: Mapping[str, Any]) -> None:
    """Write the weights and what is needed to build the same model again."""
    header = {"kind": KIND, "schema": SCHEMA, **header, "architecture": asdict(baseline.architecture)}
    save_artefact(path, baseline.state_dict(), header)


def load_baseline(path: str | os.PathLike[str]) -> tuple[Baseline, dict[str, Any]]:
    """Read a baseline and its header.

    Raises:
        FileNotFoundError: nothing is at ``path``.
        ValueError: the file is no baseline, or one of another schema.
    """
    tensors, header = load_artefact(path, kind=KIND, schema=SCHEMA)
    baseline = Baseline(Architecture(**header["architecture"]))
    return restore(baseline, tensors, path), header
