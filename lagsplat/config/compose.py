"""One experiment, composed once and typed: the only module that knows Hydra.

``conf/`` holds values, the dataclasses of the stages hold types and domains, and this module joins the two.
Planning a workflow composes dozens of experiments, so each is kept between processes; Hydra composes new
choices only, and torch and Numba are never loaded.
"""

import difflib
import operator
import re
from collections.abc import Mapping
from contextlib import suppress
from dataclasses import asdict, fields, is_dataclass
from functools import cache, lru_cache, reduce
from pathlib import Path
from typing import Any, TypeVar

import msgspec

from lagsplat.config import schema
from lagsplat.config.schema import GROUPS, Config
from lagsplat.provenance import code_digest, recall, sha256_hex

OPEN_TABLES = ("diagnose.columns=", "diagnose.columns.", "diagnose.targets=", "diagnose.targets.")
"""Beginnings of overrides of tables whose keys the user chooses: they may set keys that ``conf/`` lacks."""
Section = TypeVar("Section")


class ConfigError(ValueError):
    """A configuration that cannot be run; the message names the key, where it stands and the remedy."""


@lru_cache(maxsize=256)
def compose(*overrides: str) -> Config:
    """The experiment that ``conf/`` and these Hydra overrides describe, typed and checked.

    Of two choices for the same group the last one wins. The result is shared between callers and must not
    be changed.

    Raises:
        ConfigError: an unknown key or choice, a value of the wrong type or outside its domain.

    Example:
        >>> import lagsplat
        >>> lagsplat.compose("system=rainbow_rocker", "stage1.steps=9").stage1.steps
        9
    """
    for item in overrides:
        if not re.match(r"[A-Za-z_][\w.]*=", item):
            raise ConfigError(f"override {item!r} is not key=value; only keys that exist in conf/ can be set")
    # Hydra refuses two choices for one group; the last one wins here, so that a path can overrule a user.
    kept = list({key_of(item): item for item in overrides}.values())
    return msgspec.convert(_recall_composed(kept), Config)


def _recall_composed(overrides: list[str]) -> dict[str, Any]:
    """The experiment as plain data. Hydra takes 0.7 s for one; values are set in what their choices gave."""
    choices = [item for item in overrides if key_of(item) in GROUPS]

    def make() -> dict[str, Any]:
        if len(choices) < len(overrides):
            values = [item for item in overrides if item not in choices]
            # no such key, or another type or domain: Hydra then converts the values, or says what is wrong
            with suppress(KeyError, TypeError, ValueError):
                return _set_values(_recall_composed(choices), values)
        return asdict(_compose_anew(overrides))

    composed: dict[str, Any] = recall(f"experiment {_conf_digest(schema.CONF)} {overrides}", make)
    return composed


def _set_values(composed: dict[str, Any], overrides: list[str]) -> dict[str, Any]:
    """``composed`` with these values, where each replaces one of its own type that no other follows."""
    from hydra.core.override_parser.overrides_parser import OverridesParser
    from hydra.errors import HydraException

    try:
        parsed = OverridesParser.create().parse_overrides(overrides)
    except HydraException as error:
        raise ValueError("not in Hydra's grammar") from error
    followed = _followed_keys(schema.CONF)
    for override in parsed:
        key, value = override.key_or_group, override.value()
        if override.is_sweep_override() or "${" in str(value) or isinstance(value, dict) or key in followed:
            raise KeyError(key)
        *sections, name = key.split(".")
        section = reduce(operator.getitem, sections, composed)
        if isinstance(section[name], dict):
            raise KeyError(key)
        section[name] = value
    return asdict(msgspec.convert(composed, Config))


@cache
def _followed_keys(conf: Path) -> set[str]:
    """Keys whose values are those of other keys too: ``${system.d}``."""
    texts = [path.read_text(encoding="utf-8") for path in conf.rglob("*.yaml")]
    return {key for text in texts for key in re.findall(r"\$\{([\w.]+)\}", text)}


@cache
def _conf_digest(conf: Path) -> str:
    """Digest of the values in ``conf`` and of the code that types and checks them."""
    # places within conf/, so that a copy of the pipeline knows the answers that are copied with it
    files = [
        f"{path.relative_to(conf)} {sha256_hex(path.read_bytes())}" for path in sorted(conf.rglob("*.yaml"))
    ]
    return sha256_hex("\n".join([*files, code_digest(__name__, schema.__name__)]).encode())


def _compose_anew(overrides: list[str]) -> Config:
    from hydra import compose as hydra_compose
    from hydra import initialize_config_dir
    from hydra.core.config_store import ConfigStore
    from hydra.errors import HydraException
    from omegaconf import OmegaConf, open_dict
    from omegaconf.errors import OmegaConfBaseException

    ConfigStore.instance().store(name="schema", node=Config)
    try:
        with initialize_config_dir(str(schema.CONF), version_base="1.3"):
            words = [f"++{item}" if item.startswith(OPEN_TABLES) else item for item in overrides]
            tree = hydra_compose("config", words, return_hydra_config=True)
        choices = {group: str(tree.hydra.runtime.choices[group]) for group in GROUPS}
        with open_dict(tree):
            tree.pop("hydra")
        tree.choices = choices
        experiment = OmegaConf.to_object(tree)
    except (HydraException, OmegaConfBaseException, ValueError) as error:
        raise ConfigError(_explain(error, overrides)) from error
    assert isinstance(experiment, Config)
    return experiment


def key_of(override: str) -> str:
    """The key that an override ``key=value`` sets."""
    return override.partition("=")[0]


def rebuild(section: type[Section], values: Mapping[str, Any]) -> Section:
    """A section of the configuration from plain data, checked again.

    Raises:
        ConfigError: values that do not fit the section, for instance of an artefact of another version.
    """
    from omegaconf import OmegaConf
    from omegaconf.errors import OmegaConfBaseException

    try:
        tree = OmegaConf.merge(OmegaConf.structured(section), dict(values))
        return OmegaConf.to_object(tree)  # type: ignore[return-value]
    except (OmegaConfBaseException, ValueError) as error:
        raise ConfigError(f"{section.__name__}: {error}") from error


def _explain(error: BaseException | None, overrides: list[str]) -> str:
    """Turn the composer's chain of errors into what was found, where, and what to do."""
    parts = []
    while error is not None:
        if (text := " ".join(str(error).split())) not in parts:
            parts.append(text)
        error = error.__cause__
    advice = r" ?(To append to your config|Config search path:|Set the environment).*?(?= \| |$)"
    text = re.sub(advice, "", " | ".join(parts))
    text = re.sub(r" (full_key|reference_type|object_type)[:=]", r"; \1:", text)
    text = re.sub(r"In '([\w/]+)'", r"conf/\1.yaml", text)
    if found := re.search(r"Key '(\w+)' (?:is )?not in '(\w+)'", text):
        known = _keys_of(found[2])
        text += f". Unknown key {found[1]!r}{closest(found[1], known)}; known: {', '.join(known)}"
    elif found := re.search(r"(?:full_key: |override '?)(\w+)[.=]", text):
        text += f". Values in use: conf/{found[1]}"
    return text + (f" [overrides: {' '.join(overrides)}]" if overrides else "")


def _keys_of(name: str) -> list[str]:
    """Fields of the configuration class ``name``, wherever it stands below :class:`Config`."""
    waiting: list[type] = [Config]
    while waiting:
        section = waiting.pop()
        if section.__name__ == name:
            return [field.name for field in fields(section)]
        kinds = [kind for f in fields(section) for kind in (f.type, *getattr(f.type, "__args__", ()))]
        waiting += [kind for kind in kinds if isinstance(kind, type) and is_dataclass(kind)]
    return []


def closest(word: str, known: list[str]) -> str:
    """A hint at the known word nearest to a misspelt one, or nothing where none is near."""
    near = difflib.get_close_matches(word, known, n=1)
    return f" (did you mean {near[0]!r}?)" if near else ""
