"""Checks of the domains of settings; the message names the key, its value and where to set it."""


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
