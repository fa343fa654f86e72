"""A calibrated choice between alternatives: the conditional (McFadden) logit on their features.

The probability of an alternative is proportional to ``exp(weights . features)``. All effects share the
weights, so that a catalogue with other effects needs no new ones. They are fitted by penalised maximum
likelihood to recordings whose truth is known.

Source: McFadden, "Conditional logit analysis of qualitative choice behavior", 1974.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cache
from pathlib import Path

import numpy as np
from jaxtyping import Bool, Float64
from scipy.optimize import minimize
from scipy.special import logsumexp

from lagsplat.diagnose.verdict.features import NAMES
from lagsplat.io.files.atomic import load_json

CALIBRATED = Path(__file__).with_name("model.json")


@dataclass(frozen=True)
class Choice:
    """One recording: the features (n, k) of its alternatives, and which of them are right (n,)."""

    features: Float64[np.ndarray, "n k"]
    right: Bool[np.ndarray, " n"]
    weight: float = 1.0


@dataclass(frozen=True)
class ChoiceModel:
    """Weights (k,) of the features called ``names``."""

    names: tuple[str, ...]
    weights: Float64[np.ndarray, " k"]

    def log_probabilities(self, features: Float64[np.ndarray, "n k"]) -> Float64[np.ndarray, " n"]:
        """Logarithm of the probability of each alternative."""
        utility = features @ self.weights
        return utility - logsumexp(utility)


def fit_choice_model(choices: Sequence[Choice], names: tuple[str, ...], *, ridge: float) -> ChoiceModel:
    """Fit the weights to choices by maximum likelihood with a normal prior of precision ``ridge``.

    Where several alternatives are right, their probabilities add up. Choices without a right alternative are
    left out.
    """
    used = [choice for choice in choices if choice.right.any()]
    sizes = np.array([len(choice.right) for choice in used])
    features = np.concatenate([choice.features for choice in used])
    right = np.concatenate([choice.right for choice in used])
    weight = np.array([choice.weight for choice in used])
    first = np.concatenate([[0], np.cumsum(sizes)[:-1]])
    owner = np.repeat(np.arange(len(used)), sizes)
    scale = np.maximum(np.sqrt(np.mean(features**2, axis=0)), 1e-9)
    scaled = features / scale

    def loss(w: np.ndarray) -> tuple[float, np.ndarray]:
        utility = scaled @ w
        top = np.maximum.reduceat(utility, first)[owner]
        e = np.exp(utility - top)
        every, good = np.add.reduceat(e, first), np.add.reduceat(e * right, first)
        good = np.maximum(good, 1e-300)
        share = e / every[owner] - e * right / good[owner]
        value = float(weight @ (np.log(every) - np.log(good))) + 0.5 * ridge * float(w @ w)
        return value, scaled.T @ (share * weight[owner]) + ridge * w

    # close to the optimum, so that rounding on another processor moves no digit that is published
    options = {"maxiter": 5000, "ftol": 1e-15, "gtol": 1e-9}
    found = minimize(loss, np.zeros(features.shape[1]), jac=True, method="L-BFGS-B", options=options)
    return ChoiceModel(names, found.x / scale)


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
