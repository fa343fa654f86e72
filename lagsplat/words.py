"""Words of the command line: ``key=value`` of a command's own, and overrides of the configuration."""

from lagsplat.config import ConfigError


def split(
    words: list[str], *, needed: tuple[str, ...], allowed: tuple[str, ...]
) -> tuple[dict[str, str], list[str]]:
    """The command's own keys, and the overrides of the configuration."""
    pairs = [(word, *word.partition("=")[::2]) for word in words]
    own = {key: value for _, key, value in pairs if key in allowed}
    if missing := [key for key in needed if not own.get(key)]:
        raise ConfigError(f"{missing[0]}=... is missing")
    return own, [word for word, key, _ in pairs if key not in allowed]


def names_in(text: str | None) -> list[str] | None:
    """The names in ``[a,b]`` or ``a,b``; None of None."""
    if text is None:
        return None
    return [name.strip() for name in text.strip("[]").split(",") if name.strip()]
