"""Parts of pages that are made from the code and from ``conf/`` when the documentation is built.

A page asks for a part by a comment such as ``<!-- generated: effects -->``. Nothing here loads torch.
"""

import ast
import inspect
import math
import re
from collections.abc import Callable, Iterable
from pathlib import Path
from typing import Any

ROOT = Path(__file__).resolve().parents[2]
PLACE = re.compile(r"<!-- generated: (\w+) ?(\w*) -->")
API = {
    "recordings": ("array_types", "io", "video_quality", "views", "novel_views", "systems"),
    "models": ("stage1", "chart", "stage2", "splat", "baselines", "evaluate", "runs", "config"),
    "pushing": ("forces", "viewer", "export"),
    "diagnosis": ("diagnose", "report"),
    "other": (),
}
"""Folders whose public names a page describes; the last page gets the names of all other folders."""
BY_NAME = {"view": "pushing", "push": "pushing", "export_page": "pushing", "evaluate": "models"}
"""Pages of names that live in folders such as `pipelines`, which serve several pages."""


GROUPS = {
    "A": "Parameters",
    "B": "Dissipation",
    "C": "Actuation",
    "D": "Memory",
    "E": "Contact and external forces",
    "F": "Structure",
    "G": "Sensor and clock",
}
"""Groups of effects, in the order of the catalogue's page."""


def fill(markdown: str) -> str:
    """The page with each comment replaced by the part that it asks for."""
    return PLACE.sub(lambda match: PARTS[match[1]](match[2]), markdown)


def public_names() -> dict[str, str]:
    """Each public name of the package with the module that defines it, read without importing the package."""
    tree = ast.parse((ROOT / "lagsplat" / "__init__.py").read_text())
    names: dict[str, str] = {}
    for node in ast.walk(tree):
        if isinstance(node, ast.Dict):
            for key, value in zip(node.keys, node.values, strict=True):
                where = _text(value)
                if _text(key) and where.startswith("lagsplat."):
                    names[_text(key)] = _module(where.replace(":", "."))
    return names


def _module(path: str) -> str:
    """The module that a dotted path names, or that the object at its end is defined in."""
    file = ROOT / path.replace(".", "/")
    there = file.with_suffix(".py").exists() or (file / "__init__.py").exists()
    return path if there else path.rpartition(".")[0]


def _text(node: ast.expr | None) -> str:
    """The string that a node holds, or the first of a tuple; empty for anything else."""
    if isinstance(node, ast.Tuple) and node.elts:
        node = node.elts[0]
    return node.value if isinstance(node, ast.Constant) and isinstance(node.value, str) else ""


def page_of(name: str, module: str) -> str:
    """The page of the reference on which a public name is described."""
    folder = module.split(".")[1]
    if name in BY_NAME:
        return BY_NAME[name]
    if "diagnos" in name or "diagnos" in module:
        return "diagnosis"
    return next((page for page, folders in API.items() if folder in folders), "other")


def _api(page: str) -> str:
    chosen = {name: module for name, module in public_names().items() if page_of(name, module) == page}
    return "\n\n".join(f"::: {module}.{name}" for name, module in chosen.items())


def _effects(_: str) -> str:
    from lagsplat.diagnose.effects.registry import catalogue

    effects, parts = catalogue().values(), []
    for group, title in GROUPS.items():
        chosen = sorted((e for e in effects if e.group == group), key=lambda effect: effect.number)
        if chosen:
            parts += [f"## {title}", *(_effect(effect, effects) for effect in chosen)]
    return "\n\n".join(parts)


def _effect(effect: Any, effects: Iterable[Any]) -> str:
    from lagsplat.diagnose.effects.parameters import UNITS

    lines = [f"### `{effect.name}`"]
    lines.append(f"{effect.what} *Symptom:* {effect.symptom} *Remedy:* {effect.remedy}")
    lines.append(f"Equation: `{effect.equation}`. A recording needs {effect.needs or 'nothing special'}.")
    if effect.parameters:
        rows = [
            f"| {p.name} | {UNITS[p.kind].replace('{', '').replace('}', '')} | {_prior(p.prior)} |"
            for p in effect.parameters
        ]
        lines.append("\n".join(["| parameter | unit | prior |", "|---|---|---|", *rows]))
    similar = {other.name for other in effects if effect.name in other.confusable_with}
    if similar := similar | set(effect.confusable_with):
        names = ", ".join(f"[`{name}`](#{name})" for name in sorted(similar))
        lines.append(f"May be confused with {names}.")
    mujoco = f"none, {effect.mujoco}" if isinstance(effect.mujoco, str) else inspect.getdoc(effect.mujoco)
    lines.append(f"Counterpart in MuJoCo: {mujoco}")
    return "\n\n".join(lines)


def _prior(prior: Any) -> str:
    kind, mean, spread = type(prior).__name__, prior.mean, prior.deviation
    if kind == "LogNormal":
        return f"log-normal, median {math.exp(mean):.3g}, standard deviation of the logarithm {spread:g}"
    if kind == "HalfNormal":
        return f"half-normal, scale {spread:g}"
    centre = f"mean {mean:g}, " if mean else ""
    return f"normal, {centre}standard deviation {spread:g}"


def _configuration_groups(_: str) -> str:
    rows = ["| group | choices |", "|---|---|"]
    for folder in sorted(path for path in (ROOT / "conf").iterdir() if path.is_dir()):
        choices = ", ".join(f"`{file.stem}`" for file in sorted(folder.glob("*.yaml")))
        rows.append(f"| `{folder.name}` | {choices} |")
    return "\n".join(rows)


def _configuration_values(_: str) -> str:
    """Of each group the file that the defaults list names, or its only one."""
    listed = dict(re.findall(r"^  - (\w+): (\w+)", (ROOT / "conf" / "config.yaml").read_text(), re.MULTILINE))
    parts = []
    for folder in sorted(path for path in (ROOT / "conf").iterdir() if path.is_dir()):
        file = folder / f"{listed.get(folder.name, 'default')}.yaml"
        if file.exists():
            name = f"conf/{folder.name}/{file.name}"
            parts.append(f'## {folder.name}\n\n```yaml title="{name}"\n{file.read_text().rstrip()}\n```')
    return "\n\n".join(parts)


def _verbs(_: str) -> str:
    from lagsplat.cli.main import VERBS

    parts = []
    for name, verb in VERBS.items():
        usage = "\n".join(f"lagsplat {name} {words}" for words in verb.usage)
        rows: list[str] = []
        for key, text in (*verb.flags, *verb.keys):
            if key:
                rows.append(f"| <code>{key.replace('|', '&#124;')}</code> | {text.replace('|', '&#124;')} |")
            else:  # the text of the key before goes on
                rows[-1] = f"{rows[-1].removesuffix(' |')} {text} |"
        parts += [
            f"## {name}",
            verb.summary,
            f"```bash\n{usage}\n```",
            "\n".join(["| key | meaning |", "|---|---|", *rows]),
            f"Example: `{verb.example}`",
        ]
    return "\n\n".join(parts)


PARTS: dict[str, Callable[[str], str]] = {
    "api": _api,
    "effects": _effects,
    "groups": _configuration_groups,
    "values": _configuration_values,
    "verbs": _verbs,
}
