"""What a diagnosis says, as plain data: the content of ``diagnosis.json`` and of its report."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64

SCHEMA = 1
Verdict = Literal["effect", "none", "unknown", "undetermined"]


@dataclass(frozen=True)
class Parameter:
    """A fitted parameter with its 90 % interval; lists where an effect happens several times."""

    value: Any
    low: Any
    high: Any
    unit: str


@dataclass(frozen=True)
class Interval:
    """A number with its 95 % interval; None where it is not defined."""

    value: float | None
    low: float | None
    high: float | None


@dataclass(frozen=True)
class Candidate:
    """One hypothesis: an effect at its best place, ``none`` or ``unknown``."""

    name: str
    probability: float
    coordinate: str | None = None
    input: str | None = None
    parameters: Mapping[str, Parameter] = field(default_factory=dict)
    closure: Interval | None = None
    log_evidence: float = 0.0
    """Over ``none`` [nat]."""
    misfit: float | None = None
    """Mean square of its residual, in units of the noise."""
    places: tuple[str, ...] = ()
    """The coordinates or the inputs, where it acts at several at once."""


@dataclass(frozen=True)
class Gap:
    """Root mean square of the held-out forecasts' errors, in fractions of each coordinate's rms."""

    before: float
    """The sim as delivered."""
    refit: float
    """The sim with its own parameters moved within their uncertainty, and nothing added."""
    after: float
    """With the chosen effects."""
    floor: float
    """What the true model would leave, given the noise."""
    horizon_s: float
    closure: Interval
    """Share of what is above the floor that the chosen effects and the refit take away."""
    blocks: int = 0
    """Forecasts that were made, each over the horizon."""
    diverged: Mapping[str, int] = field(default_factory=dict)
    """How many of them left the measurement for good, by ``before``, ``refit`` and ``after``; all of them
    stand in the root mean squares."""


@dataclass(frozen=True)
class Block:
    """One held-out stretch: what was measured, and two forecasts from states of its first ten samples."""

    file: str
    index: int
    time_s: Float64[np.ndarray, " n"]
    real: Float64[np.ndarray, "n d"]
    sim: Float64[np.ndarray, "n d"]
    augmented: Float64[np.ndarray, "n d"]


@dataclass(frozen=True)
class Diagnosis:
    """The verdict with everything it rests on; candidates stand most probable first."""

    verdict: Verdict
    candidates: tuple[Candidate, ...]
    combination: tuple[str, ...]
    gap: Gap | None
    where: Any
    equivalent: tuple[tuple[str, ...], ...]
    excitation: tuple[str, ...]
    warnings: tuple[str, ...]
    absorbed: tuple[str, ...]
    """Effects that a sim fitted on the same recording has already taken up."""
    blocks: tuple[Block, ...]
    checks: Mapping[str, Any]
    """What the recording allows: periods, noise, excitation of each family."""
    q_names: tuple[str, ...] = ()
    u_names: tuple[str, ...] = ()
