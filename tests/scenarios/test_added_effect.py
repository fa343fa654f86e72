"""An effect that is defined in one new file, and nowhere else, is an effect like all others."""

import ast
import importlib.util
from collections.abc import Iterator
from dataclasses import replace
from importlib.metadata import EntryPoint
from pathlib import Path

import numpy as np
import pytest

from lagsplat.diagnose.core.result import Candidate
from lagsplat.diagnose.effects import registry
from lagsplat.diagnose.effects.base import Effect
from lagsplat.diagnose.effects.registry import (
    catalogue,
    describe_effect,
    find_confusable,
    list_names,
    register_effect,
    short_title,
)
from lagsplat.report.diagnosis.summary import name_candidate

ROOT = Path(__file__).resolve().parents[2]
PACKAGE = ROOT / "lagsplat"
RATCHET = '''
"""Friction in one direction of motion only."""

import math

from lagsplat.diagnose.effects.base import ForceEffect
from lagsplat.diagnose.effects.parameters import EffectParameter, HalfNormal
from lagsplat.diagnose.solvers.force_laws import compile_force_law


@compile_force_law
def force(t, s, v, spring, drive, memory, theta, d_memory):
    """``-acceleration`` while ``v > 0``."""
    return -theta[0] * 0.5 * (1.0 + math.tanh(20.0 * v))


EFFECT = ForceEffect(
    name="ratchet",
    group="B",
    equation="a = -acceleration where v > 0",
    parameters=(EffectParameter("acceleration", "acceleration", HalfNormal(0.2)),),
    law=force,
    title="a ratchet",
    kind="mechanism",
    what="A pawl rubs in one direction of motion only.",
    symptom="Swings in one direction are shorter.",
    remedy="Add the friction of the pawl to the simulation.",
    confusable_with=("coulomb_friction",),
    mujoco="the friction loss of a joint is the same in both directions",
)
'''


@pytest.fixture(scope="module")
def ratchet(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Effect]:
    path = tmp_path_factory.mktemp("effects") / "ratchet.py"
    path.write_text(RATCHET)
    yield register_effect(path)
    del registry._registered["ratchet"]


def test_it_is_in_the_catalogue(ratchet: Effect) -> None:
    assert catalogue()["ratchet"] is ratchet
    assert list(catalogue()) == sorted(catalogue())
    names = list_names()
    assert names.index("quadratic_drag") < names.index("ratchet") < names.index("input_lag")


def test_it_may_be_confused_both_ways(ratchet: Effect) -> None:
    assert find_confusable("ratchet") == {"ratchet", "coulomb_friction"}
    assert "ratchet" in find_confusable("coulomb_friction")


def test_the_report_has_words_for_it(ratchet: Effect) -> None:
    assert describe_effect("ratchet").what.startswith("A pawl")
    assert short_title("ratchet") == "ratchet"
    candidate = Candidate("ratchet", 0.9, "q0", None)
    assert name_candidate(candidate) == "ratchet at q0"


def test_the_documentation_describes_it(ratchet: Effect) -> None:
    spec = importlib.util.spec_from_file_location("generate", ROOT / "docs" / "site" / "generate.py")
    assert spec is not None
    assert spec.loader is not None
    generate = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(generate)
    page = generate.fill("<!-- generated: effects -->")
    entry = page.split("### `ratchet`")[1].split("###")[0]
    for text in (
        "A pawl rubs",
        "a = -acceleration where v > 0",
        "`coulomb_friction`",
        "same in both directions",
    ):
        assert text in entry


def test_its_law_is_compiled(ratchet: Effect) -> None:
    law = ratchet.law  # type: ignore[attr-defined]
    nothing = np.zeros(0)
    assert law(0.0, 0.0, 1.0, 0.0, 0.0, nothing, np.array([2.0]), nothing) == pytest.approx(-2.0)
    assert law(0.0, 0.0, -1.0, 0.0, 0.0, nothing, np.array([2.0]), nothing) == pytest.approx(0.0)


def test_a_name_stands_once(ratchet: Effect, tmp_path: Path) -> None:
    with pytest.raises(ValueError, match="in the catalogue already"):
        register_effect(catalogue()["creep"])
    (tmp_path / "empty.py").write_text("EFFECT = None\n")
    with pytest.raises(TypeError, match="defines no effect named EFFECT"):
        register_effect(tmp_path / "empty.py")
    with pytest.raises(FileNotFoundError, match="no such file"):
        register_effect(tmp_path / "gone.py")


def test_installed_packages_may_bring_effects(ratchet: Effect, monkeypatch: pytest.MonkeyPatch) -> None:
    other = replace(ratchet, name="pawl")

    def entry_points(group: str) -> list[EntryPoint]:
        assert group == "lagsplat.effects"
        return [EntryPoint("pawl", "some_package.pawl:EFFECT", group)]

    monkeypatch.setattr(registry, "entry_points", entry_points)
    monkeypatch.setattr(EntryPoint, "load", lambda self: other)
    registry._installed_effects.cache_clear()
    try:
        assert catalogue()["pawl"] is other
    finally:
        registry._installed_effects.cache_clear()


def test_no_other_file_names_an_effect() -> None:
    """Names of effects stand in the files of effects alone."""
    own = set(catalogue()) - {"armature"}  # what MuJoCo calls an attribute of a joint, too
    named = []
    for path in sorted(PACKAGE.rglob("*.py")):
        if path.parent.parent == PACKAGE / "diagnose" / "effects" or path.name == "registry.py":
            continue
        named += [
            f"{path.relative_to(ROOT)}:{node.lineno} {node.value}"
            for node in ast.walk(ast.parse(path.read_text(encoding="utf-8")))
            if isinstance(node, ast.Constant) and isinstance(node.value, str) and node.value in own
        ]
    assert named == []


def test_every_effect_says_what_mujoco_has_of_it() -> None:
    for effect in catalogue().values():
        assert callable(effect.mujoco) or len(effect.mujoco) > 20, effect.name


def test_rivals_name_effects_that_exist() -> None:
    known = catalogue()
    for effect in known.values():
        assert set(effect.confusable_with) <= set(known) - {effect.name}
