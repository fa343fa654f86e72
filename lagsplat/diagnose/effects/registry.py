"""The catalogue: every effect by its name, found in the folders of this package."""

from importlib import import_module
from pkgutil import walk_packages

from lagsplat.diagnose import effects
from lagsplat.diagnose.effects.base import Effect


def catalogue() -> dict[str, Effect]:
    """All effects by name: the `EFFECT` of every module in a folder of `lagsplat.diagnose.effects`."""
    modules = [
        import_module(info.name)
        for info in walk_packages(effects.__path__, f"{effects.__name__}.")
        if not info.ispkg and info.name.count(".") > effects.__name__.count(".") + 1
    ]
    return {module.EFFECT.name: module.EFFECT for module in sorted(modules, key=lambda m: m.EFFECT.name)}
