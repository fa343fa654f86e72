"""The road from two arguments to a diagnosis on disk, for the command line and the workflow."""

import logging
from collections.abc import Callable, Sequence
from dataclasses import asdict, dataclass, replace
from pathlib import Path

from tqdm import tqdm

from lagsplat.diagnose.check import Checked, check
from lagsplat.diagnose.config import DiagnoseConfig
from lagsplat.diagnose.diagnose import diagnose
from lagsplat.diagnose.excitation import Excitation, excitation
from lagsplat.diagnose.result import Candidate, Diagnosis
from lagsplat.diagnose.sources import Source, find_sources, read_sources
from lagsplat.diagnose.stand import Sim, sim_of
from lagsplat.diagnose.where import locate
from lagsplat.io.motion import Motion

log = logging.getLogger(__name__)
UNSURE = 0.4
"""Probability that no name exceeds where the data forbid a verdict."""


@dataclass(frozen=True)
class Pair:
    """A sim and the motions it is held against, checked."""

    sim: Sim
    checked: Checked
    rows: tuple[Excitation, ...]

    @property
    def real(self) -> tuple[Motion, ...]:
        """The real motions, cut where they are not continued."""
        return self.checked.real.motions


def open_pair(sim: str, real: str, config: DiagnoseConfig) -> Pair:
    """What the arguments name, read and checked, and the sim's model.

    Raises:
        FileNotFoundError, ValueError: nothing is there, it cannot be read, or the sides cannot be compared.
    """
    sims, reals = find_sources(sim), find_sources(real)
    sim_motions, real_motions = read_sources(sims), read_sources(reals)
    checked = check(sim_motions, real_motions)
    assert checked.sim is not None
    model = sim_of(checked.sim.motions, config)
    period_s = checked.real.period_s or checked.sim.period_s
    rows: tuple[Excitation, ...] = ()
    if period_s is not None:
        rows = excitation(
            checked.real.motions,
            period_s=period_s,
            noise=checked.real.noise,
            closed_loop=checked.closed_loop,
        )
    return Pair(model, checked, rows)


def examine(pair: Pair, config: DiagnoseConfig, *, tell: Callable[[str], None]) -> Diagnosis:
    """The diagnosis of a checked pair, with where the gap lies and what to record next."""
    found = diagnose(pair.sim, pair.real, config, tell=tell)
    tell("where")
    where = locate(
        pair.sim.model, pair.real, period_s=found.checks["natural_period_s"], hold=config.input_hold
    )
    found = replace(
        found,
        where=where,
        warnings=(*pair.checked.warnings, *found.warnings),
        excitation=tuple(f"{row.effect}: {row.record}" for row in pair.rows if row.record),
        checks={**found.checks, "excitation": [asdict(row) for row in pair.rows]},
    )
    return undecided(found) if pair.checked.undetermined else found


def undecided(found: Diagnosis) -> Diagnosis:
    """The same without a verdict: no name keeps more than `UNSURE`, the rest is spread evenly."""
    top = found.candidates[0].probability
    share = min(1.0, UNSURE / top)
    spread = (1.0 - share) / len(found.candidates)
    flat = tuple(replace(c, probability=share * c.probability + spread) for c in found.candidates)
    return replace(found, verdict="undetermined", candidates=flat, combination=())


class Bar:
    """A progress bar that names what is being tried."""

    def __init__(self, total: int) -> None:
        self.bar = tqdm(total=total, unit="effect", leave=False)

    def __call__(self, name: str) -> None:
        self.bar.set_description(name)
        self.bar.update()

    def close(self) -> None:
        """Take the bar away."""
        self.bar.close()


__all__ = ["Candidate", "Path", "Sequence", "Source", "examine", "open_pair"]
