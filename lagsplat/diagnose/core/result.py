"""The result of a diagnosis as plain data: findings on recordings, candidates, gap and verdict."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any, Literal

import numpy as np
from jaxtyping import Float64

LEVELS = ("refuse", "undetermined", "warn", "note")
"""``refuse``: nothing can be computed. ``undetermined``: any name would be a guess. ``warn``: the diagnosis
goes on, with less to go by. ``note``: worth knowing."""


@dataclass(frozen=True)
class Finding:
    """One finding of a check on the data.

    ``check`` names the check, ``source`` the file, and ``columns`` the coordinates or inputs. ``what`` was
    found, ``why`` it matters, and the ``remedy`` are sentences without a full stop.

    Raises:
        ValueError: an unknown level.
    """

    level: str
    check: str
    source: str
    what: str
    why: str
    remedy: str
    columns: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.level not in LEVELS:
            raise ValueError(f"a finding of level {self.level!r}; the levels are {LEVELS}")

    @property
    def text(self) -> str:
        """The finding in one line."""
        return f"{self.source}: {self.what}. {self.why[:1].upper()}{self.why[1:]}; {self.remedy}"


def refuse(findings: Sequence[Finding]) -> None:
    """Raise where a finding says that nothing can be computed.

    Raises:
        ValueError: a finding of level ``refuse``; the message holds all of them.
    """
    grave = [finding.text for finding in findings if finding.level == "refuse"]
    if grave:
        raise ValueError("\n".join(grave))


SCHEMA = 1  # version of the layout of `diagnosis.json`
Verdict = Literal["effect", "none", "unknown", "undetermined"]


@dataclass(frozen=True)
class Parameter:
    """A fitted parameter with its 90 % interval; lists where an effect occurs several times."""

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
    log_evidence: float = 0.0  # over `none` [nat]
    misfit: float | None = None  # mean square of its residual, in units of the noise
    places: tuple[str, ...] = ()  # the coordinates or inputs, where the effect acts at several at once


@dataclass(frozen=True)
class Gap:
    """Root mean square errors of held-out forecasts [rms of each coordinate]."""

    before: float  # the sim as given
    refit: float  # the sim with its nuisance parameters fitted, and no effect
    after: float  # with the chosen effects
    floor: float  # the error of the true model, by the measurement noise
    horizon_s: float
    closure: Interval  # share of the gap above the floor that the chosen effects and the refit remove
    blocks: int = 0  # number of forecasts, each over the horizon
    diverged: Mapping[str, int] = field(default_factory=dict)
    """Number of forecasts that diverged, by ``before``, ``refit`` and ``after``; the errors include them."""


@dataclass(frozen=True)
class FileAgreement:
    """One of several recordings: its gap, and whether the cause found in all of them holds in it.

    ``before`` and ``floor`` are as in `Gap`, of all of this file; ``after`` is with effects that were fitted
    to the other files alone.
    """

    file: str
    before: float
    after: float
    floor: float
    blocks: int  # number of forecasts
    own_lead: float | None  # log evidence of parameters of its own over shared ones [nat]; None if undefined
    name: str  # the best explanation of this file alone, where it is decisively better than the common one
    disagrees: str = ""  # what is different in this file; empty where it agrees


@dataclass(frozen=True)
class Suggestion:
    """One experiment to do next, and the log Bayes factor [nat] that it is expected to give."""

    kind: str
    text: str  # what to do, for how long, and which observation decides
    duration_s: float
    nats: float  # mean over draws from both fits; ``low`` and ``high`` are the least and the most of them
    low: float
    high: float
    repeats: int  # recordings that decide
    coordinate: str  # where both differ most, and when
    time_s: float
    expected: tuple[float, float]  # its value then, by either hypothesis
    start: Mapping[str, float]  # coordinates where it starts, at rest
    input: Mapping[str, Any] = field(default_factory=dict)
    """Times ``t`` [s] and inputs by name, (N,) each; written to a table of its own."""


@dataclass(frozen=True)
class NextExperiments:
    """Experiments that separate two hypotheses, the best per second first; ``reason`` where there is none."""

    between: tuple[str, ...]
    suggestions: tuple[Suggestion, ...]
    reason: str = ""


@dataclass(frozen=True)
class Block:
    """One held-out block: the measurement, and two forecasts from states fitted to its first samples."""

    file: str
    index: int
    time_s: Float64[np.ndarray, " n"]
    real: Float64[np.ndarray, "n d"]
    sim: Float64[np.ndarray, "n d"]
    augmented: Float64[np.ndarray, "n d"]


@dataclass(frozen=True)
class Diagnosis:
    """The verdict with its evidence; the most probable candidate comes first."""

    verdict: Verdict
    candidates: tuple[Candidate, ...]
    combination: tuple[str, ...]
    gap: Gap | None
    where: Any
    equivalent: tuple[tuple[str, ...], ...]
    excitation: tuple[str, ...]
    warnings: tuple[str, ...]
    absorbed: tuple[str, ...]
    """Effects that a sim fitted on the same recording has already absorbed."""
    blocks: tuple[Block, ...]
    checks: Mapping[str, Any]
    """Numbers behind the verdict: periods, noise, misfits, excitation of each effect, robustness."""
    q_names: tuple[str, ...] = ()
    u_names: tuple[str, ...] = ()
    files: tuple[FileAgreement, ...] = ()  # each recording, where there are several
    next_experiments: NextExperiments | None = None
