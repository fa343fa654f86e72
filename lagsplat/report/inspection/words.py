"""Names and quoted values in proposed settings."""

import re


def make_name(path: str) -> str:
    """A name of letters, digits and underscores for a path."""
    return re.sub(r"\W+", "_", path).strip("_")


def quote(text: str) -> str:
    """Quote a value as the grammar of Hydra requires: brackets and spaces need quotes."""
    plain = re.fullmatch(r"[\w/.-]+( [\w/.-]+)*", text, re.ASCII)
    return text if plain else '"' + text.replace('"', '\\"') + '"'
