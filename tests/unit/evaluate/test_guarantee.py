"""What no trained law can break, and that a broken one is told from it."""

import pytest
import torch

from lagsplat.evaluate.guarantee import measure_guarantee, summarize_guarantees
from lagsplat.report.tables.learned_physics import build_guarantee_table
from lagsplat.stage2.lagrangian import Lagrangian
from tests.stage2_problems import random_lagrangian
from tests.unit.evaluate import swing, tiny_run

PATH = ("system", "recording", "profile", "stage1", "ae", "stage2", "seed")
RUN = dict.fromkeys(PATH, "swing")


def asked(lagrangian: Lagrangian, **changes: object) -> dict:
    config = swing.settings(guarantee={"duration_s": 100.0, "starts": 4, **changes}).guarantee
    return summarize_guarantees(lagrangian, reach=2.0, dt_s=0.02, config=config)


@pytest.mark.parametrize(
    ("d", "mass", "far"), [(1, "learned", 2.0), (1, "constant", 2.0), (2, "learned", 1.0)]
)
def test_every_law_of_the_class_comes_to_rest(d: int, mass: str, far: float) -> None:
    found = asked(random_lagrangian(d, 0, 7, mass=mass), far=far)
    assert found["holds"], found
    assert found["free_settled"] == found["held_settled"] == 4
    assert found["held_force_error"] < 0.01
    assert found["rise_at_half_step"] <= found["rise"] + 1e-9


def test_a_law_that_feeds_its_motion_is_found_out() -> None:
    lagrangian = random_lagrangian(1, 0, 7, damping="constant")
    with torch.no_grad():
        lagrangian.damping_term.factor.zero_()
    lagrangian.damping_term.floor = -0.05
    found = asked(lagrangian, duration_s=1.0)
    assert not found["holds"]
    assert found["free_settled"] == 0


def test_an_induced_mass_cannot_be_asked_and_says_so() -> None:
    chart = tiny_run.chart(tiny_run.autoencoder(1, swing.SIDE), swing.recording())
    config = swing.settings().guarantee
    found = measure_guarantee(random_lagrangian(1, 0, 1, mass="induced"), chart, config)
    table = build_guarantee_table([RUN, RUN], [found, measure_guarantee(swing.lagrangian(), chart, config)])
    assert "decoder-induced" in table["reason"][0]
    assert table["holds"][1]
    assert table["free_settled"][1] == 4
    with pytest.raises(ValueError, match="no learned Lagrangian to check"):
        build_guarantee_table([], [])


def test_time_that_is_too_short_is_not_called_settled() -> None:
    found = asked(random_lagrangian(1, 0, 7), duration_s=0.5)
    assert not found["holds"]
