"""The user's cache, for what takes long to make and belongs to no results."""

import os
from pathlib import Path

from lagsplat.provenance import sha256_hex

DIGEST_DIGITS = 16  # of a name: enough that no two entries share one


def locate_in_cache(kind: str, key: str) -> Path:
    """The path in the user's cache of the entry of a ``kind``, a folder, which ``key`` determines.

    Nothing is created. The cache is ``lagsplat`` in ``XDG_CACHE_HOME``, or else in ``~/.cache``.
    """
    cache = Path(os.environ.get("XDG_CACHE_HOME") or "~/.cache").expanduser()
    return cache / "lagsplat" / kind / sha256_hex(key.encode())[:DIGEST_DIGITS]
