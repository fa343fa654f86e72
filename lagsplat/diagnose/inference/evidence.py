"""The fit of one hypothesis, and its evidence by Laplace's approximation."""

from dataclasses import dataclass, field

import numpy as np

from lagsplat.diagnose.effects.base import PlacedEffect, SampleEffect
from lagsplat.diagnose.estimation.multiple_shooting import ShootingFit
from lagsplat.diagnose.estimation.rollout import RolloutModel
from lagsplat.diagnose.inference.problem import make_joint_prior


@dataclass(frozen=True)
class HypothesisFit:
    """A set of effects, fitted to the data. The sim alone (`none`) is the empty set."""

    effects: tuple[PlacedEffect, ...]
    fit: ShootingFit
    log_evidence: float = float("nan")
    """Log evidence over `none` [nat]."""
    noise: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    """Parameters of an effect on single samples: estimate and both ends of the 90 % interval."""

    @property
    def name(self) -> str:
        """Name of the effect that was added last."""
        return self.effects[-1].effect.name

    @property
    def n_effect_parameters(self) -> int:
        """Number of fitted parameters that belong to the effects; nuisance parameters follow them."""
        return sum(len(e.effect.parameters) for e in self.effects)

    def parameter_slice(self, placed: PlacedEffect) -> slice:
        """Where the parameters of one of the effects are in ``fit.x``; effects on single samples have
        none."""
        fitted = [e for e in self.effects if not isinstance(e.effect, SampleEffect)]
        at = sum(len(e.effect.parameters) for e in fitted[: fitted.index(placed)])
        return slice(at, at + len(placed.effect.parameters))


def compute_log_evidence(
    hypothesis: HypothesisFit, rollout_model: RolloutModel, noise_inflation: float
) -> float:
    """Laplace's approximation of the log evidence [nat].

    Args:
        hypothesis: the effects with their fit.
        rollout_model: the sim beside the data, with the prior of the nuisance parameters.
        noise_inflation: factor on the variance of the noise.

    Source: MacKay, "Information Theory, Inference, and Learning Algorithms", 2003, ch. 28.
    """
    prior, fit = make_joint_prior(hypothesis.effects, rollout_model), hypothesis.fit
    effect_priors = [p.prior for e in hypothesis.effects for p in e.effect.parameters]
    log_prior = sum(p.log_density(float(x)) for p, x in zip(effect_priors, fit.x, strict=False))
    nuisance = fit.x[hypothesis.n_effect_parameters :] / prior.deviation[hypothesis.n_effect_parameters :]
    nuisance_log_prior = -0.5 * float(nuisance @ nuisance) - float(
        np.log(prior.deviation[hypothesis.n_effect_parameters :]).sum()
    )
    nuisance_log_prior -= 0.5 * len(nuisance) * np.log(2.0 * np.pi)
    h = fit.curvature / noise_inflation + np.diag(1.0 / prior.deviation**2)
    sign, log_det = np.linalg.slogdet(h)
    if sign <= 0:
        log_det = float(np.log(np.maximum(np.linalg.eigvalsh(h), 1e-12)).sum())
    k = len(fit.x)
    return (
        -0.5 * fit.misfit / noise_inflation
        + log_prior
        + nuisance_log_prior
        + 0.5 * k * np.log(2.0 * np.pi)
        - 0.5 * log_det
        - 0.5 * fit.log_det_starts
    )
