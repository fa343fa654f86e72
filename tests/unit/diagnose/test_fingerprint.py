"""What a written-down residual goes with leads its row; chance rarely passes the bound."""

import numpy as np
import pytest

from lagsplat.diagnose.residual.components import compute_residual_correlations
from tests.unit.diagnose.residuals import made

LAWS = {
    "u0": lambda t, q, v, u: 0.5 * u,
    "q³": lambda t, q, v, u: 0.5 * q**3,
    "v": lambda t, q, v, u: -0.3 * v,
    "sign v": lambda t, q, v, u: -0.3 * np.sign(v),
    "|v| v": lambda t, q, v, u: -0.02 * np.abs(v) * v,
}


def row(smoothed):
    found = compute_residual_correlations(smoothed, q_names=["q0"], u_names=["u0"])
    return dict(zip(found.regressors, found.score[0], strict=True))


@pytest.mark.parametrize("name", sorted(LAWS))
def test_the_law_behind_the_residual_leads_or_nearly_so(name):
    scores = row([made(LAWS[name])])
    assert scores[name] > 0.85 * max(scores.values())  # v and |v| v are much alike
    assert scores[name] > 1.0


def test_chance_passes_the_bound_as_often_as_the_bound_says():
    scores = np.array([list(row([made(lambda t, q, v, u: 0.0 * q, seed=k)]).values()) for k in range(60)])
    assert 0.01 < np.mean(scores > 1.0) < 0.10


def test_clips_are_not_glued():
    first, second = made(LAWS["sign v"], seed=1), made(LAWS["sign v"], seed=2)
    assert row([first, second])["sign v"] > row([first])["sign v"]


def test_a_silent_coordinate_and_a_constant_input_score_nothing():
    silent = made(LAWS["v"], coordinates=2, quiet=(1,))
    silent.motion.u[:] = 3.0
    found = compute_residual_correlations([silent], q_names=["a", "b"], u_names=["u0"])
    assert not found.score[1].any()
    assert not found.score[:, :2].any()
    assert found.coordinates == ("a", "b")
