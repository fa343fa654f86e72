"""The catalogue: every effect by its name, with its words for people.

An effect enters the catalogue in one of three ways:

- a module of this package, in one of its folders, defines `EFFECT`;
- an installed package names it under the entry point group ``lagsplat.effects``;
- a script calls `register_effect` with the effect or with the path of a file that defines `EFFECT`.
"""

import os
import sys
from functools import cache
from importlib import import_module
from importlib.metadata import entry_points
from importlib.util import module_from_spec, spec_from_file_location
from pathlib import Path
from pkgutil import walk_packages

from lagsplat.diagnose import effects
from lagsplat.diagnose.effects.base import Effect, EffectDescription

ENTRY_POINTS = "lagsplat.effects"
VERDICTS = {
    "none": EffectDescription(
        title="nothing",
        kind="verdict",
        what="The simulation and the recording agree as well as noise and the simulation's own uncertainty "
        "allow.",
        symptom="The forecasts miss by no more than the true model would.",
        remedy="Keep the simulation as it is.",
    ),
    "unknown": EffectDescription(
        title="something that is not in the catalogue",
        kind="verdict",
        what="A gap is there, and no effect of the catalogue explains it.",
        symptom="Even the best candidate leaves more than noise behind.",
        remedy="Look at where the residual acts, in time and along the motion, before anything is added.",
    ),
}
"""Names that a diagnosis gives beside those of effects."""
_registered: dict[str, Effect] = {}


def catalogue() -> dict[str, Effect]:
    """All effects by name, in alphabetical order.

    Example:
        >>> catalogue()["coulomb_friction"].equation
        'a = -acceleration sign(v)'
    """
    known = _installed_effects() | _registered
    return {name: known[name] for name in sorted(known)}


def register_effect(source: Effect | str | os.PathLike[str]) -> Effect:
    """Add an effect to the catalogue of this process: the effect itself, or a file that defines `EFFECT`.

    Raises:
        FileNotFoundError: no such file.
        TypeError: the file defines no effect under the name `EFFECT`.
        ValueError: an effect of the package or of another file has this name already.
    """
    effect = source if isinstance(source, Effect) else _load_effect(Path(source))
    if effect.name in _installed_effects() or effect.name in VERDICTS:
        raise ValueError(f"an effect called {effect.name!r} is in the catalogue already; give another name")
    _registered[effect.name] = effect
    return effect


def list_effects() -> list[Effect]:
    """All effects in the order in which people read them: by group, and by number within it.

    Example:
        >>> import lagsplat
        >>> "coulomb_friction" in [effect.name for effect in lagsplat.effects()]
        True
    """
    return sorted(catalogue().values(), key=lambda effect: (effect.group, effect.number, effect.name))


def list_names() -> list[str]:
    """Every name that a diagnosis may give: `none`, the effects by group, and `unknown`."""
    return ["none", "unknown", *(effect.name for effect in list_effects())]


def find_confusable(name: str) -> set[str]:
    """Effects that some recordings cannot separate from ``name``; ``name`` itself if there are any."""
    known = catalogue()
    named = set(known[name].confusable_with) if name in known else set()
    others = named | {other.name for other in known.values() if name in other.confusable_with}
    return others | {name} if others else set()


def describe_effect(name: str) -> EffectDescription:
    """The words for ``name``.

    Raises:
        ValueError: a name that no diagnosis gives.
    """
    known = {**catalogue(), **VERDICTS}
    if name not in known:
        raise ValueError(f"no effect is called {name!r}; known are {', '.join(list_names())}")
    return known[name]


def short_title(name: str) -> str:
    """The name as people write it: ``coulomb_friction`` is "Coulomb friction"."""
    effect = catalogue().get(name)
    return (effect.short_title if effect else "") or name.replace("_", " ")


def label_parameter(name: str, parameter: str) -> str:
    """How a reported parameter of effect ``name`` is called in a sentence."""
    effect = catalogue().get(name)
    labels = {p.name: p.label for p in effect.parameters if p.label} if effect else {}
    return labels.get(parameter, parameter.replace("_", " "))


@cache
def _installed_effects() -> dict[str, Effect]:
    names = (info.name for info in walk_packages(effects.__path__, f"{effects.__name__}.") if not info.ispkg)
    inner = [name for name in names if name.count(".") > effects.__name__.count(".") + 1]
    installed = [_effect_of(import_module(name), name) for name in inner]
    for entry in entry_points(group=ENTRY_POINTS):
        loaded = entry.load()
        installed.append(loaded if isinstance(loaded, Effect) else _effect_of(loaded, entry.value))
    known: dict[str, Effect] = {}
    for effect in installed:
        if effect.name in known:
            raise ValueError(f"two effects are called {effect.name!r}; rename one or uninstall its package")
        known[effect.name] = effect
    return known


def _load_effect(path: Path) -> Effect:
    if not path.is_file():
        raise FileNotFoundError(f"{path}: no such file; give a Python file that defines EFFECT")
    # a name that survives a second import, so that compiled laws are found in Numba's cache
    name = f"lagsplat_effect_{path.stem}"
    spec = spec_from_file_location(name, path)
    assert spec is not None
    assert spec.loader is not None
    module = module_from_spec(spec)
    sys.modules[name] = module
    spec.loader.exec_module(module)
    return _effect_of(module, str(path))


def _effect_of(module: object, where: str) -> Effect:
    effect = getattr(module, "EFFECT", None)
    if not isinstance(effect, Effect):
        raise TypeError(f"{where}: defines no effect named EFFECT; see lagsplat.diagnose.effects.base")
    return effect
