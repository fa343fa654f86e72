"""A calibrated choice between alternatives: the conditional (McFadden) logit on their features.

The probability of an alternative is proportional to ``exp(weights . features)``. All effects share the
weights, so that a catalogue with other effects needs no new ones. They are fitted to recordings whose truth
is known (`snakemake results/calibration/model.json`).

Source: McFadden, "Conditional logit analysis of qualitative choice behavior", 1974.
"""

from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Float64
from scipy.special import logsumexp

from lagsplat.diagnose.verdict.features import NAMES
from lagsplat.io.files.atomic import load_json

CALIBRATED = Path(__file__).with_name("model.json")


@dataclass(frozen=True)
class ChoiceModel:
    """Weights (k,) of the features called ``names``."""

    names: tuple[str, ...]
    weights: Float64[np.ndarray, " k"]

    def log_probabilities(self, features: Float64[np.ndarray, "n k"]) -> Float64[np.ndarray, " n"]:
        """Logarithm of the probability of each alternative."""
        utility = features @ self.weights
        return utility - logsumexp(utility)


@cache
def load_choice_model(path: Path = CALIBRATED) -> ChoiceModel:
    """The model of a file, by default the calibrated one of this package.

    Raises:
        ValueError: the file holds weights of other features.
    """
    weights = load_json(path)["weights"]
    if set(weights) != set(NAMES):
        wrong = ", ".join(sorted(set(weights) ^ set(NAMES)))
        raise ValueError(f"{path}: {wrong}: weights of other features than are computed; calibrate again")
    return ChoiceModel(NAMES, np.array([float(weights[name]) for name in NAMES]))
