"""Names and quoted values in proposed settings."""

import re
from collections.abc import Mapping


def make_name(path: str) -> str:
    """A name of letters, digits and underscores for a path."""
    return re.sub(r"\W+", "_", path).strip("_")


def quote(text: str) -> str:
    """Quote a value as the grammar of Hydra requires: brackets and spaces need quotes."""
    plain = re.fullmatch(r"[\w/.-]+( [\w/.-]+)*", text, re.ASCII)
    return text if plain else '"' + text.replace('"', '\\"') + '"'


def pair_columns(columns: Mapping[str, str]) -> str:
    """Standard names and the columns of a file, as ``t: time, q0: angle``."""
    return ", ".join(f"{key}: {quote(name)}" for key, name in columns.items())


def write_columns(columns: Mapping[str, str]) -> str:
    """The override that maps standard names to these columns of a file, before a shell's quotes."""
    return f"diagnose.columns={{{pair_columns(columns)}}}"
