"""The bar has a total from the start, keeps it as an upper bound, and lines stand above it once."""

import io
from dataclasses import replace

import pytest

from lagsplat.config.compose import compose
from lagsplat.diagnose.data_quality.checks import check_data
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.pipelines.diagnosis_progress import ProgressDisplay, count_steps
from tests.unit.diagnose.motions import swing


def test_a_smaller_catalogue_takes_fewer_steps() -> None:
    config = compose().diagnose
    few = replace(config, without=sorted(catalogue())[2:])
    assert count_steps(few) < count_steps(config)


def test_the_checks_are_shown_before_any_step() -> None:
    seen = io.StringIO()
    with ProgressDisplay(compose().diagnose, seen) as display:
        assert f"of at most {count_steps(compose().diagnose)}" in seen.getvalue()
        display.show_checks(check_data((), [swing(seconds=2.0)]))
        display("coulomb_friction")
        display.warn("warning: once")
        display.warn("warning: once")
    said = seen.getvalue()
    assert said.index("data: 1.983 s, 120 samples; natural period 1.1 s; noise (rms) q0") < said.index(
        "coulomb f"
    )
    assert "warning: real: 1.98 s, or 1.8 natural periods" in said
    assert said.count("warning: once") == 1


@pytest.mark.parametrize(("remaining", "total"), [(None, 200), (7, 207)])
def test_a_search_that_goes_on_longer_extends_the_total(remaining: int | None, total: int) -> None:
    seen = io.StringIO()
    with ProgressDisplay(compose().diagnose, seen) as display:
        for _ in range(199):
            display("creep")
        display("creep", remaining)
        display._bar.refresh()
        assert f"of at most {max(total, 201)}" in seen.getvalue()
