"""Mutation testing: small changes of the code, each of which a test should notice.

Usage: ``python -m tests.campaign.mutants GROUP SEED COUNT``, with cosmic-ray 8.7.0 on the path, whose
operators make the changes. A group is some modules and the tests that state what they do. COUNT changes are
drawn without replacement. A process that has run the tests once forks for each, imports the package with the
change, and runs them until one fails. Left out is what every test would notice: changes of annotations,
operators on bits in place of arithmetic, and what does not compile. Prints what survived, and the share
that died with its 95 % interval (Wilson).
"""

import ast
import contextlib
import os
import random
import signal
import sys
import time
import warnings
from collections.abc import Iterator
from dataclasses import dataclass
from importlib.machinery import SourceFileLoader
from pathlib import Path

# OpenMP does not outlive a fork
os.environ |= {"NUMBA_NUM_THREADS": "1", "NUMBA_THREADING_LAYER": "workqueue"}

import hypothesis
import pytest
from cosmic_ray.ast import ast_nodes, get_ast
from cosmic_ray.mutating import mutate_code
from cosmic_ray.plugins import get_operator, operator_names
from scipy.stats import binomtest

IMPORTED = "ignore::pytest.PytestAssertRewriteWarning"  # of plugins, by the process that forks
ARITHMETIC = {"Add", "Sub", "Mul", "Div", "Pow"}
BITS = {"BitAnd", "BitOr"}
PATIENCE_S = 30.0  # beyond five times what the tests take without a change
ROOT = Path(__file__).resolve().parents[2]
GROUPS = {
    "image_model": (
        ["lagsplat/splat/image_model.py"],
        [
            "tests/unit/splat/test_image_model.py",
            "tests/unit/splat/test_backend.py",
            "tests/unit/splat/test_raster.py",
            "tests/oracle/test_raster.py",
            "tests/laws/test_raster.py",
        ],
    ),
    "law": (
        ["lagsplat/stage2/lagrangian.py", "lagsplat/stage2/numpy_lagrangian.py"],
        [
            "tests/laws/test_law_forms.py",
            "tests/oracle/test_acceleration.py",
            "tests/oracle/test_numpy_lagrangian.py",
            "tests/unit/stage2/test_lagrangian.py",
            "tests/unit/forces/test_loaded_lagrangian.py",
            "tests/laws/test_signed_inputs.py",
        ],
    ),
    "verdict": (
        [
            f"lagsplat/diagnose/verdict/{name}.py"
            for name in ("alternatives", "choice_model", "features", "judgement")
        ],
        [
            f"tests/unit/diagnose/verdict/test_{name}.py"
            for name in ("features", "judgement", "choice_model", "alternatives")
        ],
    ),
    "diagnosis": (
        ["lagsplat/diagnose/diagnosis.py"],
        [
            "tests/unit/diagnose/test_materiality.py",
            "tests/unit/diagnose/inference/test_null_evidence.py",
            "tests/unit/diagnose/inference/test_recalibration.py",
            "tests/unit/diagnose/inference/test_effect_sets.py",
        ],
    ),
}


@dataclass(frozen=True)
class Mutant:
    """The ``occurrence``-th place in a file where an operator of cosmic-ray applies."""

    path: str
    operator: str
    occurrence: int
    line: int

    def read(self) -> str:
        """The source with the change."""
        source = (ROOT / self.path).read_text()
        return mutate_code(source, get_operator(self.operator)(), self.occurrence) or source

    def __str__(self) -> str:
        lines = ((ROOT / self.path).read_text(), self.read())
        before, after = (text.splitlines()[self.line - 1].strip() for text in lines)
        return f"{self.path}:{self.line} {self.operator}\n    - {before}\n    + {after}"


def is_considered(operator: str) -> bool:
    """Whether an operator changes what a test could miss."""
    kind, _, change = operator.removeprefix("core/").partition("_")
    if kind == "ReplaceBinaryOperator":
        return set(change.split("_")) <= ARITHMETIC or set(change.split("_")) <= BITS
    return not kind.startswith("Variable")


def list_mutants(path: str) -> Iterator[Mutant]:
    """Every change of a file outside annotations."""
    source = (ROOT / path).read_text()
    nodes, tree = list(ast.walk(ast.parse(source))), get_ast(source)
    notes = [getattr(node, name, None) for node in nodes for name in ("annotation", "returns")]
    spans = [((n.lineno, n.col_offset), (n.end_lineno, n.end_col_offset)) for n in notes if n is not None]
    for name in filter(is_considered, operator_names()):
        operator = get_operator(name)()
        places = (place for node in ast_nodes(tree) for place in operator.mutation_positions(node))
        for occurrence, (start, _) in enumerate(places):
            if not any(first <= start < last for first, last in spans):
                yield Mutant(path, name, occurrence, start[0])


def compiles(source: str) -> bool:
    """Whether Python takes the source, without a warning either."""
    with contextlib.suppress(SyntaxError), warnings.catch_warnings():
        warnings.simplefilter("error")
        compile(source, "changed", "exec")
        return True
    return False


def run_tests(tests: list[str], *options: str) -> int:
    """Run tests in this process until one fails; the exit code of pytest."""
    return pytest.main(["-x", "-q", "-p", "no:cacheprovider", "-W", IMPORTED, *options, *tests])


def list_dependents(path: str) -> list[str]:
    """The loaded modules whose code reaches that of a file, which is loaded, and all those of tests."""
    from lagsplat.provenance import _digest_and_imports  # not before pytest, whose plugin checks its shapes

    loaded = [name for name in sys.modules if name.partition(".")[0] == "lagsplat"]
    imports = {name: set(_digest_and_imports(name)[1]) for name in loaded if name != "lagsplat"}
    found = {path.removesuffix(".py").replace("/", ".")}
    while more := {name for name, own in imports.items() if own & found} - found:
        found |= more
    return [name for name in sys.modules if name in found or name.partition(".")[0] == "tests"]


def forget(names: list[str]) -> None:
    """Have modules imported anew."""
    for name in names:
        above, _, last = name.rpartition(".")
        if above in sys.modules and hasattr(sys.modules[above], last):
            delattr(sys.modules[above], last)
        del sys.modules[name]


def survives(mutant: Mutant, tests: list[str], bound_s: float) -> bool:
    """Whether all tests pass in a fork of this process with the change, in time."""
    child = os.fork()
    if child == 0:
        silence = os.open(os.devnull, os.O_WRONLY)
        os.dup2(silence, 1)
        os.dup2(silence, 2)
        signal.alarm(int(bound_s) + 1)
        install(mutant)
        # without those that make jaxtyping check shapes: this process does so already
        os._exit(int(run_tests(tests, "-o", "addopts=--import-mode=importlib -m 'not campaign'")))
    return os.waitpid(child, 0)[1] == 0


def install(mutant: Mutant) -> None:
    """Have the next import of the file read the change, whatever is cached of it."""
    forget(list_dependents(mutant.path))
    source, path, original = mutant.read(), str(ROOT / mutant.path), SourceFileLoader.get_code

    def get_code(loader: SourceFileLoader, name: str) -> object:
        if loader.path == path:
            return loader.source_to_code(source.encode(), path)
        return original(loader, name)

    SourceFileLoader.get_code = get_code


def main(group: str, seed: int, count: int) -> None:
    """Draw changes of a group, try each, and print what was found."""
    paths, tests = GROUPS[group]
    every = [mutant for path in paths for mutant in list_mutants(path)]
    random.Random(seed).shuffle(every)
    drawn = [mutant for mutant in every[: 2 * count] if compiles(mutant.read())][:count]
    quick = hypothesis.settings(database=None, derandomize=True, phases=["explicit", "generate"])
    hypothesis.settings.register_profile("mutants", quick)
    hypothesis.settings.load_profile("mutants")
    run_tests(tests)
    start = time.monotonic()
    if not survives(Mutant(paths[0], "core/NumberReplacer", 10**6, 1), tests, 3600.0):
        sys.exit("the tests fail without a change")
    passed_s = time.monotonic() - start
    bound_s = PATIENCE_S + 5.0 * passed_s
    print(f"{len(every)} places, {len(drawn)} drawn; {passed_s:.1f} s without a change", flush=True)
    survived = 0
    for number, mutant in enumerate(drawn, 1):
        if survives(mutant, tests, bound_s):
            survived += 1
            print(f"{number}: {mutant}", flush=True)
    died, share = len(drawn) - survived, 1.0 - survived / len(drawn)
    low, high = binomtest(died, len(drawn)).proportion_ci(method="wilson")
    print(f"{group}, seed {seed}: {died} of {len(drawn)} died, {share:.1%} ({low:.1%} to {high:.1%})")


if __name__ == "__main__":
    main(sys.argv[1], int(sys.argv[2]), int(sys.argv[3]))
