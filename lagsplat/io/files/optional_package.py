"""Packages that only some files need, which an extra of this package installs."""

from importlib import import_module
from typing import Any


def require_package(name: str, *, what: str, extra: str) -> Any:
    """The module ``name``, which ``what`` needs and the optional dependencies ``extra`` install.

    Raises:
        ValueError: it is not installed.
    """
    try:
        return import_module(name)
    except ImportError as error:
        raise ValueError(
            f"{what} needs the package {name}; install it with: pip install 'lagsplat[{extra}]'"
        ) from error
