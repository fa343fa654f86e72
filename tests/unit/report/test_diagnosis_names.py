"""How a diagnosis names an effect and the places where it acts."""

import pytest

from lagsplat.diagnose.core.result import Candidate
from lagsplat.report.diagnosis.summary import name_candidate, title_candidate


@pytest.mark.parametrize(
    ("candidate", "short", "end"),
    [
        (Candidate("coulomb_friction", 0.9, coordinate="q1"), "Coulomb friction at q1", "at q1"),
        (
            Candidate("coulomb_friction", 0.9, places=("q0", "q1")),
            "Coulomb friction at q0 and q1",
            "q0 and q1",
        ),
        (Candidate("input_lag", 0.9, input="u0"), "input lag of u0", "input u0"),
        (
            Candidate("input_lag", 0.9, places=("u0", "u1", "u2")),
            "input lag of u0, u1 and u2",
            "u0, u1 and u2",
        ),
    ],
)
def test_an_effect_is_named_with_all_its_places(candidate: Candidate, short: str, end: str) -> None:
    assert name_candidate(candidate) == short
    assert title_candidate(candidate).endswith(end)
    assert "at u0" not in title_candidate(candidate)
