"""Five short lines for every verdict."""

from dataclasses import replace

import pytest

from lagsplat.report.diagnosis.lines import MAX_WIDTH, write_lines
from tests.unit.report.diagnosis import made_diagnoses

KINDS = made_diagnoses.every_kind()
REPORT = "out/report.html"


def write(kind: str, **changes: object) -> dict[str, str]:
    lines = write_lines(replace(KINDS[kind], **changes), report=REPORT)
    return {name: text.strip() for name, _, text in (line.partition(":") for line in lines)}


@pytest.mark.parametrize("kind", KINDS)
def test_every_verdict_has_the_five_lines_in_their_order(kind: str) -> None:
    lines = write_lines(KINDS[kind], report=REPORT)
    assert [line.partition(":")[0] for line in lines] == ["verdict", "gap", "where", "shrinks", "next"]
    assert max(len(line.removesuffix(f" (more: {REPORT})")) for line in lines) <= MAX_WIDTH
    assert lines[-1].endswith(f" (more: {REPORT})")
    assert not any("\n" in line for line in lines)


def test_an_effect_is_named_with_its_probability_and_what_it_closes() -> None:
    found = write("single")
    assert found["verdict"] == "Coulomb friction at q1 (probability 0.99)"
    assert found["gap"] == "forecasts over 1.2 s miss by 13 % of the motion; floor 3.5 %, by noise"
    assert found["where"].startswith("in the motion itself, mostly q1; most like a loss of energy")
    assert found["shrinks"].startswith("to 3.9 % with Coulomb friction at q1; to 11 %")
    assert found["next"].startswith("Add Coulomb friction")


def test_nothing_is_advised_of_a_cause_that_is_undecided() -> None:
    assert not write("undecided")["next"].startswith("Add")
    assert write("undecided")["next"].startswith("To tell them apart, record ")


def test_without_an_effect_nothing_is_added() -> None:
    assert write("unknown")["shrinks"].endswith("nothing is added")
    assert write("none")["where"] == "no gap to locate"
    assert write("undetermined")["verdict"].endswith("the recording lasts only 1.4 periods")
    assert write("undetermined")["gap"].startswith("not measured")
    assert write("single", gap=None)["shrinks"] == "not measured"
