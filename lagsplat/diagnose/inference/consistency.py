"""Several recordings of one mechanism: whether the cause that was found in all of them holds in each.

Each file in turn is left out: the effects are fitted to the others and forecast it. A file disagrees where
parameters of its own, or another effect, explain it decisively better and close a material share of its gap.
Laws are approximate, so that among many samples the evidence alone would find every file different.
"""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
from jaxtyping import Int64

from lagsplat.diagnose.core.config import EXPERIMENT, SELECTION
from lagsplat.diagnose.core.result import FileAgreement
from lagsplat.diagnose.effects.registry import find_confusable, short_title
from lagsplat.diagnose.estimation.dataset import Dataset, WindowSet
from lagsplat.diagnose.inference.holdout import (
    HeldOutBlocks,
    HeldOutForecast,
    forecast_blocks,
    keep_plausible,
)
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit, compute_log_evidence
from lagsplat.diagnose.mechanics.model import MechanicalModel


def check_files(
    problem: EstimationProblem,
    chosen: HypothesisFit,
    rivals: Sequence[HypothesisFit],
    *,
    given: MechanicalModel,
    noise_inflation: float,
    materiality: float,
) -> tuple[FileAgreement, ...]:
    """Compare every file with the others; empty where less than two can be.

    Args:
        problem: the problem of all files.
        chosen: the explanation of all files together, fitted to them.
        rivals: other explanations, `none` among them, that a file may prefer.
        given: the sim as given.
        noise_inflation: factor on the noise variance at which evidence counts.
        materiality: share of a file's gap that what is different in it must close.
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

        def forecast(part: EstimationProblem, fit: HypothesisFit, blocks: HeldOutBlocks) -> HeldOutForecast:
            x = keep_plausible(part, fit, fit.fit.x)
            return blocks.measure(forecast_blocks(problem, blocks.blocks, fit.effects, x), fit)

        before, after = held_out.forecast_given(given), forecast(others, rest, held_out)
        fits = {_name(fit): _refit(own, fit, inside) for fit in (chosen, *rivals)}
        evidence = {name: _weigh(own, fit, noise_inflation) for name, fit in fits.items()}
        usual, best = _name(chosen), max(evidence, key=lambda each: evidence[each])
        own_lead = evidence[usual] + _weigh(others, rest, noise_inflation) - whole
        material = materiality * before.rms_error
        here = forecast(own, fits[usual], held_out).rms_error
        other = forecast(own, fits[best], held_out).rms_error
        ahead = evidence[best] - evidence[usual]
        text = ""
        if ahead >= EXPERIMENT.decisive and here - other > material and best not in find_confusable(usual):
            text = f"another cause: {short_title(best)} explains it better by {ahead:.3g} nats"
        elif own_lead >= EXPERIMENT.decisive and after.rms_error - here > material:
            text = _describe_state(chosen, fits[usual])
        floor = float(np.sqrt(after.floor.mean()))
        name = best if text and best != usual else usual
        lead = own_lead if np.isfinite(own_lead) else None
        file, errors = record.files[number], (before.rms_error, after.rms_error, floor)
        rows.append(FileAgreement(file, *errors, len(held_out.real), lead, name, text))
    return tuple(rows) if len(rows) > 1 else ()


def locate_files(windows: WindowSet, record: Dataset) -> Int64[np.ndarray, " W"]:
    """Number of the file that each window lies in."""
    return record.file_of[np.searchsorted(record.clips[:, 1], windows.first, side="right")]


def _select(problem: EstimationProblem, chosen: np.ndarray) -> EstimationProblem:
    return replace(problem, windows=problem.windows.select(chosen), iterations=SELECTION.trial_iterations)


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


def _describe_state(chosen: HypothesisFit, here: HypothesisFit) -> str:
    """The parameters of a file alone beside those of all."""
    changes = []
    for placed in chosen.fitted:
        own, shared = (fit.name_parameters(placed) for fit in (here, chosen))
        changes += [f"{name} {own[name]:.3g} instead of {shared[name]:.3g}" for name in shared]
    what = "; ".join(change for change in changes if not change.startswith("memory "))
    return f"another state of the mechanism: {what or 'the simulation needs other parameters'}"
