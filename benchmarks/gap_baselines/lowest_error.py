"""Fit every effect, and take the one whose forecasts of the held-out half err least.

So friction models of servo motors are chosen, for instance (Duclusaud et al., 2024, arXiv:2410.08650). Fits
and forecasts are those of the diagnosis, every effect at its best place; its evidence, its priors over
effects, its calibration and its doubts about the sim are not used.
"""

from benchmarks.gap_baselines.case import Case
from benchmarks.gap_baselines.contest import choose_by_error, open_contest
from benchmarks.gap_baselines.said import Said, weigh
from lagsplat.diagnose.core.config import DiagnoseConfig
from lagsplat.diagnose.inference.holdout import HeldOutBlocks, split_windows
from lagsplat.diagnose.inference.model_selection import rank_hypotheses
from lagsplat.diagnose.inference.problem import HypothesisFit


def lowest_error(case: Case, config: DiagnoseConfig) -> Said:
    """The effect with the lowest mean square error over the held-out blocks, or ``none``.

    Raises:
        ValueError: the motions are too short for a single window or block.
    """
    contest = open_contest(case, config)
    ranking = rank_hypotheses(contest.problem, contest.candidates, contest.budget)
    best: dict[str, HypothesisFit] = {"none": ranking.none}
    for fit in ranking.found:
        best.setdefault(fit.name, fit)
    held_out = HeldOutBlocks(contest.problem, split_windows(contest.problem, ranking.none))
    squares = {name: held_out.forecast(fit).squares for name, fit in best.items()}
    first, scores = choose_by_error(squares)
    if first == "none":
        return Said(weigh(scores, first))
    at = best[first].effects[0]
    coordinate = at.direction.name if at.direction else None
    return Said(weigh(scores, first), coordinate, at.input_name, blocks=contest.forecast(best[first]))
