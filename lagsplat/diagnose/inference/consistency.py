"""Several recordings of one mechanism: whether the cause that was found in all of them holds in each.

Each file in turn is left out: the effects are fitted to the others and forecast it. Where parameters of its
own explain a file decisively better than shared ones, or another effect does, the file disagrees.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Int64

from lagsplat.diagnose.core.config import EXPERIMENT, ROBUSTNESS
from lagsplat.diagnose.core.result import FileAgreement
from lagsplat.diagnose.effects.registry import find_confusable, short_title
from lagsplat.diagnose.estimation.dataset import Dataset, WindowSet
from lagsplat.diagnose.inference.holdout import HeldOutBlocks, forecast_blocks, keep_plausible
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit, compute_log_evidence
from lagsplat.diagnose.mechanics.model import MechanicalModel


def check_files(
    problem: EstimationProblem,
    chosen: HypothesisFit,
    rivals: Sequence[HypothesisFit],
    *,
    given: MechanicalModel,
    noise_inflation: float,
) -> tuple[FileAgreement, ...]:
    """Compare every file with the others; empty where less than two can be.

    Args:
        problem: the problem of all files.
        chosen: the explanation of all files together, fitted to them.
        rivals: other explanations, `none` among them, that a file may prefer.
        given: the sim as given.
        noise_inflation: factor on the noise variance at which evidence counts.
    """
    home, record = locate_files(problem.windows, problem.dataset), problem.dataset
    if len(np.unique(home)) < 2:
        return ()
    whole = _weigh(problem, chosen, noise_inflation)
    rows = []
    for number in np.unique(home):
        inside = home == number
        own, others = (_select(problem, part) for part in (inside, ~inside))
        rest = _refit(others, chosen, ~inside)
        try:
            held_out = HeldOutBlocks(problem, (others, own.windows))
        except ValueError:  # not one natural period
            continue
        x = keep_plausible(others, chosen, rest.fit.x)
        forecast = forecast_blocks(problem, held_out.blocks, chosen.effects, x)
        before, after = held_out.forecast_given(given), held_out.measure(forecast, chosen)
        by_name = {_name(fit): _refit(own, fit, inside) for fit in (chosen, *rivals)}
        evidence = {name: _weigh(own, fit, noise_inflation) for name, fit in by_name.items()}
        shared = evidence[_name(chosen)]
        own_lead = shared + _weigh(others, rest, noise_inflation) - whole
        name = max(evidence, key=lambda each: evidence[each])
        rows.append(
            FileAgreement(
                file=record.files[number],
                before=float(np.sqrt(before.squares.mean())),
                after=float(np.sqrt(after.squares.mean())),
                floor=float(np.sqrt(after.floor.mean())),
                blocks=len(held_out.real),
                own_lead=own_lead,
                name=name if evidence[name] - shared >= EXPERIMENT.decisive else _name(chosen),
                disagrees=_explain(chosen, by_name, evidence, own_lead),
            )
        )
    return tuple(rows) if len(rows) > 1 else ()


def locate_files(windows: WindowSet, record: Dataset) -> Int64[np.ndarray, " W"]:
    """Number of the file that each window lies in."""
    return record.file_of[np.searchsorted(record.clips[:, 1], windows.first, side="right")]


def _select(problem: EstimationProblem, chosen: np.ndarray) -> EstimationProblem:
    return replace(problem, windows=problem.windows.select(chosen), iterations=ROBUSTNESS.iterations)


def _refit(part: EstimationProblem, hypothesis: HypothesisFit, inside: np.ndarray) -> HypothesisFit:
    """A hypothesis fitted to some windows, from where it is."""
    fit = part.fit(hypothesis.fitted, hypothesis.fit.x, hypothesis.fit.starts[inside])
    return replace(hypothesis, fit=fit)


def _weigh(part: EstimationProblem, hypothesis: HypothesisFit, noise_inflation: float) -> float:
    moving = HypothesisFit(hypothesis.fitted, hypothesis.fit)
    return compute_log_evidence(moving, part.rollout_model, noise_inflation)


def _name(hypothesis: HypothesisFit) -> str:
    """Names of the effects; `none` for the sim alone."""
    return " and ".join(placed.effect.name for placed in hypothesis.effects) or "none"


def _explain(
    chosen: HypothesisFit,
    fits: dict[str, HypothesisFit],
    evidence: dict[str, float],
    own_lead: float,
) -> str:
    """Why a file disagrees, from fits to it alone; empty where it does not."""
    usual = _name(chosen)
    best = max(evidence, key=lambda each: evidence[each])
    ahead = evidence[best] - evidence[usual]
    if ahead >= EXPERIMENT.decisive and best not in find_confusable(usual):
        return f"another cause: {short_title(best)} explains it better by {ahead:.3g} nats"
    if own_lead < EXPERIMENT.decisive:
        return ""
    changes = []
    for placed in chosen.fitted:
        here, there = (fit.name_parameters(placed) for fit in (fits[usual], chosen))
        changes += [f"{name} {here[name]:.3g} instead of {there[name]:.3g}" for name in there]
    what = "; ".join(change for change in changes if not change.startswith("memory"))
    return f"another state of the mechanism: {what or 'the simulation needs other parameters'}"
