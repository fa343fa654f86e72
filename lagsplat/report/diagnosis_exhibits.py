"""What a report of a diagnosis may show beside the diagnosis itself; every part may be missing."""

from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any

import numpy as np
from jaxtyping import Float64, UInt8

from lagsplat.diagnose.fingerprint import Fingerprint
from lagsplat.diagnose.profile import Profile
from lagsplat.diagnose.separability import Separability


@dataclass(frozen=True)
class PictureGap:
    """Excess error (H, W) of the sim's pictures over one; parts (left, top, right, bottom, share)."""

    picture: UInt8[np.ndarray, "H W 3"]
    excess: Float64[np.ndarray, "H W"]
    parts: tuple[tuple[int, int, int, int, float], ...] = ()


@dataclass(frozen=True)
class PictureForce:
    """Points (P, 2) of the body on one ``picture`` (x to the right, y down, pixels): the share ``explained``
    (P,) by a force on each, and mean forces (P, 2) of those ``near`` the best; no force where not
    ``localisable``."""

    picture: UInt8[np.ndarray, "H W 3"]
    points: Float64[np.ndarray, "P 2"]
    explained: Float64[np.ndarray, " P"]
    forces: Float64[np.ndarray, "P 2"]
    near: tuple[int, ...]
    localisable: bool


@dataclass(frozen=True)
class Film:
    """Pictures (T, H, W, 3) of one stretch: measured, forecast by the sim, and with the effects; shown
    ``slowed`` times slower than they were filmed."""

    real: UInt8[np.ndarray, "T H W 3"]
    sim: UInt8[np.ndarray, "T H W 3"]
    augmented: UInt8[np.ndarray, "T H W 3"]
    frames_per_s: float
    slowed: float = 1.0


@dataclass(frozen=True)
class Exhibits:
    """``rungs`` of the ladder and ``maps_after`` are as `lagsplat.diagnose` computes them (`Rung`, `Map`);
    ``steps`` (label, gap) lie between the refit sim and the last effect; ``command`` and ``digests`` say how
    the diagnosis was made, ``stamp`` with what."""

    rungs: tuple[Any, ...] = ()
    steps: tuple[tuple[str, float], ...] = ()
    maps_after: tuple[Any, ...] = ()
    separability: Separability | None = None
    profiles: tuple[Profile, ...] = ()
    fingerprint: Fingerprint | None = None
    picture: PictureGap | None = None
    force: PictureForce | None = None
    film: Film | None = None
    command: str = ""
    digests: Mapping[str, str] = field(default_factory=dict)
    stamp: Mapping[str, Any] = field(default_factory=dict)
