"""Features of the alternatives of a verdict: measures on scales on which a linear model can weigh them."""

import numpy as np
from jaxtyping import Float64

from lagsplat.diagnose.verdict.alternatives import Alternatives, Measures

OF_EFFECTS = (
    "effect",  # 1 for an effect or a set of effects
    "misfit",  # log of the mean square residual over the nominal one, at least 0
    "excess",  # that excess in standard deviations of chance, as asinh of half
    "rival_misfit",  # log of the mean square residual over the least of all alternatives
    "error",  # log of the held-out error over its floor
    "rival_error",  # log of the held-out error over the least of all alternatives
    "gain",  # log of the refit's held-out error over this one's
    "gain_z",  # asinh of the same in standard errors
    "evidence",  # log of one plus the log evidence over `none`
    "behind",  # log of one plus the nats behind the best alternative
    "leads",  # 1 for the single effect with the most evidence
    "parameters",  # number of fitted parameters
    "surprise",  # log of one plus the squared distance from the prior means
    "memory",  # log of the samples of its residual that count as one
    "refit",  # log of one plus the penalty of the sim's own parameters
    "more_effects",  # effects beside the first
    "added",  # log of the mean square residual of the best part of a set over that of the set
    "added_error",  # the same of the held-out errors
    "single_samples",  # 1 for an effect on single samples
    "sample_evidence",  # for such an effect, its evidence once more
    "flexible",  # effects that imitate many others
    "unrepeated",  # how far the data leave open that an external force is external
)
OF_NONE = ("none", "misfit", "excess", "error", "rival_error", "gain_z", "evidence", "refit")
OF_UNKNOWN = ("unknown", "misfit", "excess", "error", "memory", "left", "gap", "refit", "relaxed", "flexible")
NAMES = (
    *OF_EFFECTS,
    *("none" if name == "none" else f"none: {name}" for name in OF_NONE),
    *("unknown" if name == "unknown" else f"unknown: {name}" for name in OF_UNKNOWN),
)
"""Every feature; those of `none` are zero for effects, and so on."""


def compute_features(alternatives: Alternatives) -> Float64[np.ndarray, "n k"]:
    """Features of every measured alternative, `none` first, and of `unknown` last."""
    rows = [[0.0] * len(OF_EFFECTS) + _of_none(alternatives) + [0.0] * len(OF_UNKNOWN)]
    rows += [
        _of_effects(alternatives, m) + [0.0] * (len(OF_NONE) + len(OF_UNKNOWN))
        for m in alternatives.measures[1:]
    ]
    rows.append([0.0] * (len(OF_EFFECTS) + len(OF_NONE)) + _of_unknown(alternatives))
    return np.array(rows)


def _fit_quality(alternatives: Alternatives, m: Measures) -> list[float]:
    relative = m.misfit / alternatives.nominal
    excess = float(np.arcsinh(0.5 * (relative - 1.0) / alternatives.chance))
    return [float(np.log(max(relative, 1.0))), excess]


def _of_effects(alternatives: Alternatives, m: Measures) -> list[float]:
    evidence = float(np.log1p(max(m.log_evidence, 0.0)))
    return [
        1.0,
        *_fit_quality(alternatives, m),
        float(np.log(m.misfit / alternatives.least_misfit)),
        float(np.log(m.error / m.floor)),
        float(np.log(m.error / alternatives.least_error)),
        float(np.log(alternatives.measures[0].error / m.error)),
        float(np.arcsinh(m.gain_z)),
        evidence,
        float(np.log1p(alternatives.best.log_evidence - m.log_evidence)),
        float(m is alternatives.best_single),
        float(m.parameters),
        float(np.log1p(m.surprise)),
        float(np.log(m.memory)),
        float(np.log1p(m.refit_penalty)),
        float(len(m.names) - 1),
        *_of_last_effect(alternatives, m),
        float(m.single_samples),
        float(m.single_samples) * evidence,
        float(m.flexible),
        1.0 - m.recurrence,
    ]


def _of_last_effect(alternatives: Alternatives, m: Measures) -> list[float]:
    """What a set gains over the best of the smaller sets in it; zero for a single effect."""
    parts = [other for other in alternatives.measures[1:] if set(other.names) < set(m.names)]
    if not parts:
        return [0.0, 0.0]
    part = max(parts, key=lambda other: other.log_evidence)
    least = alternatives.nominal
    return [
        float(np.log(max(part.misfit, least) / max(m.misfit, least))),
        float(np.log(part.error / m.error)),
    ]


def _of_none(alternatives: Alternatives) -> list[float]:
    none = alternatives.measures[0]
    return [
        1.0,
        *_fit_quality(alternatives, none),
        float(np.log(none.error / none.floor)),
        float(np.log(none.error / alternatives.least_error)),
        float(np.arcsinh(max(m.gain_z for m in alternatives.measures))),
        float(np.log1p(alternatives.best.log_evidence)),
        float(np.log1p(none.refit_penalty)),
    ]


def _of_unknown(alternatives: Alternatives) -> list[float]:
    none, best = alternatives.measures[0], alternatives.best
    before, after = (max(m.misfit - alternatives.nominal, 1e-3) for m in (none, best))
    lead = alternatives.relaxed_log_evidence - best.log_evidence
    return [
        1.0,
        *_fit_quality(alternatives, best),
        float(np.log(best.error / best.floor)),
        float(np.log(best.memory)),
        float(np.log(min(after / before, 1.0))),
        float(np.log(none.error / none.floor)),
        float(np.log1p(best.refit_penalty)),
        float(np.arcsinh(lead)),
        float(best.flexible),
    ]
