"""What the methods share: a sim identified from the nominal motions, placed effects, and held-out forecasts.

The sim's own parameters are held fixed. Free to move, they would take up most changes, and the error of
``none`` would be the lowest.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from benchmarks.gap_baselines.case import Case
from lagsplat.diagnose.core.config import DiagnoseConfig
from lagsplat.diagnose.core.result import Block
from lagsplat.diagnose.effects.base import PlacedEffect
from lagsplat.diagnose.identification.estimated_simulator import estimate_simulator
from lagsplat.diagnose.inference.holdout import forecast_holdout
from lagsplat.diagnose.inference.model_selection import SearchBudget, rank_hypotheses
from lagsplat.diagnose.inference.placement import find_hints, place_effects
from lagsplat.diagnose.inference.problem import EstimationProblem, HypothesisFit, build_problem
from lagsplat.diagnose.mechanics.model import MechanicalModel

MOST = 2
"""Effects that a forecast holds at most."""
MARGIN = 1.0
"""Standard errors by which a name must beat ``none``."""


@dataclass(frozen=True)
class Place:
    """An effect that a method names, with its coordinate and its input where it has any."""

    name: str
    coordinate: str | None = None
    input: str | None = None


@dataclass(frozen=True)
class Contest:
    """The estimation problem of a recording, and the catalogue's effects at every place."""

    problem: EstimationProblem
    candidates: tuple[PlacedEffect, ...]
    budget: SearchBudget

    @property
    def model(self) -> MechanicalModel:
        """The sim."""
        return self.problem.rollout_model.model

    @cached_property
    def none(self) -> HypothesisFit:
        """The fit without effects."""
        return HypothesisFit((), self.problem.fit((), np.zeros(self.problem.rollout_model.nuisance.size)))

    def fit_named(self, named: Sequence[Place]) -> HypothesisFit:
        """Fit the catalogue's laws of the first `MOST` named effects at their places, one after another."""
        fit = self.none
        for place in named[:MOST]:
            offered = [effect for effect in self.candidates if _stands_at(effect, place)]
            known = fit if fit.effects else None
            found = rank_hypotheses(self.problem, offered, self.budget, known=known).found if offered else ()
            fit = found[0] if found else fit
        return fit

    def forecast(self, chosen: HypothesisFit) -> tuple[Block, ...]:
        """Forecasts of the held-out half, fitted to the other; none where the recording is too short."""
        try:
            return forecast_holdout(self.problem, self.none, chosen, given=self.model).blocks
        except ValueError:
            return ()


def open_contest(case: Case, config: DiagnoseConfig) -> Contest:
    """Identify the sim from the nominal motions alone, and place the effects on the real ones.

    Raises:
        ValueError: the motions are too short for a single window, or nothing moves.
    """
    sim = estimate_simulator(case.sim, config)
    problem = build_problem(sim, case.real, config)
    problem = problem.with_nuisance(problem.rollout_model.nuisance.freeze())
    hints = find_hints(sim.model, case.real, period_s=problem.period_s, hold=config.input_hold)
    names = {"q_names": case.real[0].q_names, "u_names": case.real[0].u_names}
    placed = place_effects(problem.rollout_model, hints, **names, without=config.without)
    return Contest(problem, tuple(placed), SearchBudget(config, max(1.0, sim.misfit)))


def _stands_at(effect: PlacedEffect, place: Place) -> bool:
    at = effect.direction.name if effect.direction else None
    return (
        effect.effect.name == place.name
        and (at is None or place.coordinate is None or at == place.coordinate)
        and (effect.input_name is None or place.input is None or effect.input_name == place.input)
    )


def choose_by_error(squares: Mapping[str, np.ndarray]) -> tuple[str, dict[str, float]]:
    """The name with the lowest held-out error, or ``none``, and the log likelihood of each name.

    ``squares`` holds mean squares of held-out blocks (B,) by name, ``none`` among them. ``none`` stands
    unless the mean logarithm of the best name's squares is lower by `MARGIN` standard errors: the
    one-standard-error rule (Breiman et al., "Classification and Regression Trees", 1984, ch. 3). In the
    likelihoods each block counts once, under errors as large as the best's.
    """
    means = {name: float(values.mean()) for name, values in squares.items()}
    finite = {name: value for name, value in means.items() if np.isfinite(value)}
    best = min(finite, key=lambda name: finite[name])
    n = len(squares[best])
    scores = {name: -0.5 * n * float(np.log(value / finite[best])) for name, value in finite.items()}
    drop = np.log(squares["none"] / squares[best])
    spread = float(np.std(drop, ddof=1)) / np.sqrt(n) if n > 1 else 0.0
    return (best if float(drop.mean()) > MARGIN * spread else "none"), scores
