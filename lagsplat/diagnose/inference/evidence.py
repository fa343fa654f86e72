"""Hypotheses against a record: which effects can explain it, and how well each does."""

from dataclasses import dataclass, field

import numpy as np

from lagsplat.diagnose.effects.base import PlacedEffect, SampleEffect
from lagsplat.diagnose.estimation.multiple_shooting import ShootingFit
from lagsplat.diagnose.estimation.rollout import RolloutModel
from lagsplat.diagnose.inference.problem import joint_prior


@dataclass(frozen=True)
class HypothesisFit:
    """One hypothesis after its fit."""

    effects: tuple[PlacedEffect, ...]
    fit: ShootingFit
    log_evidence: float = float("nan")
    """Over `none` [nat]."""
    noise: dict[str, tuple[float, float, float]] = field(default_factory=dict)
    """Parameters of an effect that only moves single samples, each with its 90 % interval."""

    @property
    def n_effect_parameters(self) -> int:
        """Number of unknowns that belong to the effects."""
        return sum(len(e.effect.parameters) for e in self.effects)

    def own(self, instance: PlacedEffect) -> slice:
        """Where the unknowns of one of the effects stand; what only moves single samples has none."""
        fitted = [e for e in self.effects if not isinstance(e.effect, SampleEffect)]
        at = sum(len(e.effect.parameters) for e in fitted[: fitted.index(instance)])
        return slice(at, at + len(instance.effect.parameters))


def log_evidence(one: HypothesisFit, rollout_model: RolloutModel, noise_inflation: float) -> float:
    """Laplace's approximation of the logarithm of the evidence, with the noise widened by ``noise_inflation``.

    Source: MacKay, "Information Theory, Inference, and Learning Algorithms", 2003, ch. 28.
    """
    prior, fit = joint_prior(one.effects, rollout_model), one.fit
    effect_priors = [p.prior for e in one.effects for p in e.effect.parameters]
    own = sum(p.log_density(float(x)) for p, x in zip(effect_priors, fit.x, strict=False))
    spare = fit.x[one.n_effect_parameters :] / prior.deviation[one.n_effect_parameters :]
    spare_density = -0.5 * float(spare @ spare) - float(
        np.log(prior.deviation[one.n_effect_parameters :]).sum()
    )
    spare_density -= 0.5 * len(spare) * np.log(2.0 * np.pi)
    h = fit.curvature / noise_inflation + np.diag(1.0 / prior.deviation**2)
    sign, log_det = np.linalg.slogdet(h)
    if sign <= 0:
        log_det = float(np.log(np.maximum(np.linalg.eigvalsh(h), 1e-12)).sum())
    k = len(fit.x)
    return (
        -0.5 * fit.misfit / noise_inflation
        + own
        + spare_density
        + 0.5 * k * np.log(2.0 * np.pi)
        - 0.5 * log_det
        - 0.5 * fit.log_det_starts
    )
