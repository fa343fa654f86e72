"""Alternatives that are made up: what is measured of `none`, and of effects by name."""

from dataclasses import replace

import numpy as np

from lagsplat.diagnose.estimation.multiple_shooting import ShootingFit
from lagsplat.diagnose.inference.problem import HypothesisFit
from lagsplat.diagnose.verdict.alternatives import Alternatives, Measures

EMPTY = np.zeros((1, 1, 1))
SHOOTING = ShootingFit(np.zeros(0), np.zeros((1, 2)), EMPTY, 0.0, 0.0, np.eye(0), 0.0, EMPTY, EMPTY)
FIT = HypothesisFit((), SHOOTING)
NONE = Measures(
    names=(),
    misfit=9.0,
    log_evidence=0.0,
    error=0.12,
    floor=0.02,
    gain_z=0.0,
    parameters=0,
    surprise=0.0,
    memory=20.0,
    refit_penalty=0.0,
    single_samples=False,
    flexible=0,
    recurrence=1.0,
)
RIGHT = {"misfit": 1.0, "log_evidence": 300.0, "error": 0.021, "gain_z": 8.0, "parameters": 1, "memory": 1.0}


def effect(name: str, *others: str, **measured: float) -> Measures:
    """An effect, or a set, that explains all unless something else is said."""
    return replace(NONE, names=tuple(sorted((name, *others))), **{**RIGHT, **measured})


def alternatives(*measured: Measures, none: Measures = NONE) -> Alternatives:
    """`none` and the given effects, of a sim that meets its own recordings."""
    fits = tuple(replace(FIT) for _ in range(1 + len(measured)))
    return Alternatives(
        (none, *measured), fits, nominal=1.0, chance=0.05, relaxed_log_evidence=0.0, motionless=1e4
    )
