"""Checks of the domains of settings; the message names the key, its value and where to set it."""

from collections.abc import Collection


def require_setting(key: str, value: object, holds: bool, rule: str) -> None:
    """Raise a ValueError unless ``holds``; ``key`` is the full key, such as ``ode.rate``."""
    if not holds:
        raise ValueError(f"{key}={value} {rule}; set it in conf/{key.split('.')[0]} or with {key}=...")


def require_least(config: object, group: str, least: int, *names: str) -> None:
    """Raise a ValueError unless each of these settings of ``config`` is at least ``least``."""
    for name in names:
        value = getattr(config, name)
        require_setting(f"{group}.{name}", value, value >= least, f"must be at least {least}")


def require_positive(config: object, group: str, *names: str) -> None:
    """Raise a ValueError unless each of these settings of ``config`` is positive."""
    for name in names:
        value = getattr(config, name)
        require_setting(f"{group}.{name}", value, value > 0, "must be positive")


def require_interval(config: object, group: str, interval: str, *names: str) -> None:
    """Raise a ValueError unless each of these settings lies in ``interval``, such as ``(0, 1]``."""
    low, high = (float(end) for end in interval[1:-1].split(","))
    for name in names:
        value = getattr(config, name)
        above = value >= low if interval[0] == "[" else value > low
        below = value <= high if interval[-1] == "]" else value < high
        require_setting(f"{group}.{name}", value, above and below, f"must lie in {interval}")


def require_choice(config: object, group: str, name: str, choices: Collection[str]) -> None:
    """Raise a ValueError unless this setting of ``config`` is one of ``choices``."""
    value = getattr(config, name)
    require_setting(f"{group}.{name}", value, value in choices, f"is none of {', '.join(choices)}")
