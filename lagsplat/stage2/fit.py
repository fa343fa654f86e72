"""Fits the Lagrangian to a latent trajectory, saves it and loads it."""

import time
from collections.abc import Callable, Mapping
from dataclasses import asdict
from pathlib import Path
from typing import Any

import numpy as np
import torch
from jaxtyping import Float

from lagsplat.chart.trajectory import EncodedTrajectory
from lagsplat.io.files.artifact import load_artifact, restore_module, save_artifact
from lagsplat.stage2.config import FormConfig, Stage2Config
from lagsplat.stage2.decoder_mass import DecoderGeometry
from lagsplat.stage2.input_stiffness import InputRange, InputStiffness
from lagsplat.stage2.lagrangian import Coefficients, Floors, Lagrangian, linearize_modes
from lagsplat.stage2.training import CurveRow, DynamicsFit, FitReport

KIND = "dynamics"
SCHEMA = 3


def fit_dynamics(
    trajectory: EncodedTrajectory,
    metric: Float[np.ndarray, "d d"],
    config: Stage2Config,
    seed: int,
    *,
    rest: Float[np.ndarray, " d"],
    geometry: DecoderGeometry | None = None,
    on_candidate: Callable[[CurveRow], None] = lambda row: None,
) -> tuple[Lagrangian, FitReport]:
    """Fit M, C, V and nu to a smoothed training trajectory in whitened latents.

    Three stages: constant matrices, networks on the one-step objective, networks on rollouts. The result is
    the candidate with the smallest rollout error over the clip, including the start, so that no stage can
    make it worse.

    ``metric`` is the visibility metric without ridge, ``rest`` the encoding of the rest image, ``geometry``
    that of the decoder, for an induced mass. ``on_candidate`` is called with every scored candidate.

    Raises:
        ValueError: segments too short for a window, latents that do not move, or a missing geometry.

    Source: paper, "Stage 2: Latent Lagrangian Dynamics".
    """
    torch.manual_seed(seed)
    fit = DynamicsFit(trajectory, metric, config, seed, on_candidate)
    report, best = fit.report, fit.best
    lagrangian = fit.start(torch.from_numpy(rest), geometry)
    fit.score_candidate(lagrangian, "start", 0, float("nan"))
    report.scores["start"] = best.score
    fit.train_on_steps(lagrangian)
    report.scores["one_step"] = best.score
    fit.train_on_rollouts(lagrangian)
    report.scores["shooting"] = best.score
    best.restore(lagrangian)
    report.rejected = best.rejected
    report.n_parameters = sum(p.numel() for p in lagrangian.parameters() if p.requires_grad)
    mean_input = torch.from_numpy(trajectory.inputs.mean(0))
    report.at_rest = linearize_modes(lagrangian, torch.zeros_like(mean_input))
    report.under_mean_input = linearize_modes(lagrangian, mean_input)
    report.wall_s = time.perf_counter() - fit.started_s
    return lagrangian, report


def save_dynamics(path: Path | str, lagrangian: Lagrangian, header: Mapping[str, Any]) -> None:
    """Write the parameters with form, floors, unit of time and all other settings of the law."""
    settings = {
        "d": lagrangian.d,
        "n_inputs": lagrangian.n_inputs,
        "form": asdict(lagrangian.form),
        "floors": asdict(lagrangian.floors),
        "time_unit_s": float(lagrangian.time_unit_s),
        "longest_step": lagrangian.longest_step,
        "n_primitives": getattr(lagrangian.mass_term, "n_primitives", None),
        "curved": lagrangian.curvature is not None,
        # stored only if true, as in files from before there were signed inputs
        **({"signed": True} if lagrangian.signed else {}),
    }
    header = {**header, "kind": KIND, "schema": SCHEMA, "dynamics": settings}
    save_artifact(path, lagrangian.state_dict(), header)


def load_dynamics(path: Path | str) -> tuple[Lagrangian, dict[str, Any]]:
    """Read a Lagrangian and its header; every setting comes from the file.

    Raises:
        ValueError: the file is no dynamics, or one of another schema.
    """
    tensors, header = load_artifact(path, kind=KIND, schema=SCHEMA)
    settings = header["dynamics"]
    d, n_inputs, k = settings["d"], settings["n_inputs"], settings["n_primitives"]
    eye, blank = torch.eye(d, dtype=torch.float64), torch.zeros(n_inputs, d, dtype=torch.float64)
    signed, input_stiffness, geometry = settings.get("signed", False), None, None
    if settings["curved"]:
        flat, none = 0.0 * eye.expand(n_inputs, d, d), torch.zeros(n_inputs, dtype=torch.float64)
        input_stiffness = InputStiffness(flat, flat, InputRange(none, none + float(signed)))
    if k is not None:
        zeros, ones = torch.zeros(k, 2, d, dtype=torch.float64), torch.ones(k, dtype=torch.float64)
        geometry = DecoderGeometry(zeros, zeros[:, 0], eye.expand(k, d, d), ones)
    lagrangian = Lagrangian(
        Coefficients(eye, eye, eye, blank, 0.0 * eye[0], input_stiffness),
        form=FormConfig(**settings["form"]),
        floors=Floors(**settings["floors"]),
        time_unit_s=settings["time_unit_s"],
        seed=0,
        geometry=geometry,
        signed=signed,
        longest_step=settings["longest_step"],
    )
    return restore_module(lagrangian, tensors, path), header
