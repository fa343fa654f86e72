"""Which recordings a split holds: labels in fixed shares, the rest balanced and shuffled by the key."""

import hashlib
import hmac

import numpy as np

from benchmarks.gapgen.drawing import BINS, Stratum
from benchmarks.gapgen.effect import CAMERA, FAMILIES, MEMORY, NEEDS_INPUT, OUTSIDE

NONE_SHARE, OUTSIDE_SHARE, PAIR_SHARE = 0.15, 0.12, 0.10
SYSTEMS = {
    "d1": ("pendulum", "rocker", "duffing_cart", "linear_cart"),
    "multi": ("two_link", "two_link", "bag", "soft_robot"),
    "d2": ("two_link", "bag"),
    "d4": ("soft_robot",),
}
SYSTEMS["to2"] = SYSTEMS["d1"] * 2 + SYSTEMS["d2"]
SYSTEMS["all"] = SYSTEMS["d1"] * 2 + ("two_link", "bag", "soft_robot")
NOISE, DURATION_S = (0.003, 0.01, 0.01, 0.03), (4.0, 18.0, 18.0, 60.0)
# camera and timing count as two families, unlogged pushes as half of one
WEIGHTS = {
    **dict.fromkeys(FAMILIES, 1.0),
    "external_push": 0.5,
    "time_offset": 0.6,
    "time_jitter": 0.3,
    "frame_drops": 0.3,
    "camera_change": 0.4,
    "camera_drift": 0.3,
    "exposure_blur": 0.1,
}
GROUPS = (
    ("viscous_damping", "coulomb_friction", "quadratic_drag", "stribeck_friction"),
    ("linear_stiffness", "constant_force", "cubic_stiffness", "end_stop"),
    ("input_gain", "input_delay", "input_lag", "input_dead_zone", "input_saturation", "input_backlash"),
    (*MEMORY, "external_periodic_force", "parameter_drift", "hidden_mode"),
)


def keyed(key: bytes, message: str) -> bytes:
    """HMAC-SHA256 of a message under the split's secret key."""
    return hmac.new(key, message.encode(), hashlib.sha256).digest()


def seed_of(key: bytes, identity: str) -> int:
    """Seed of a recording: nothing about it can be had from its name without the key."""
    return int.from_bytes(keyed(key, f"seed|{identity}")[:16], "big")


def identities(key: bytes, split: str, n: int) -> list[str]:
    """Random names of ``n`` recordings."""
    return [keyed(key, f"id|{split}|{k}").hex()[:12] for k in range(n)]


def _pair(rng: np.random.Generator, *, forced: bool) -> tuple[str, str]:
    groups = [g for g in GROUPS if forced or not set(g) & set(NEEDS_INPUT)]
    a, b = rng.choice(len(groups), 2, replace=False)
    return str(rng.choice(groups[a])), str(rng.choice(groups[b]))


def _spread(rng: np.random.Generator, names: list[str], weights: list[float], n: int) -> list[str]:
    """``n`` names in the shares of their weights as nearly as whole numbers allow."""
    share = np.array(weights) / np.sum(weights) * n
    count = np.floor(share).astype(int)
    left = rng.choice(
        len(names), n - int(count.sum()), replace=False, p=(share - count) / (share - count).sum()
    )
    count[left] += 1
    return [name for name, c in zip(names, count, strict=True) for _ in range(c)]


def strata(key: bytes, split: str, n: int, systems: str) -> list[Stratum]:
    """The strata of ``n`` recordings of a group of systems, in an order that only the key gives.

    Raises:
        ValueError: if the group of systems is unknown.
    """
    if systems not in SYSTEMS:
        raise ValueError(f"systems {systems!r}: none such; choose from {sorted(SYSTEMS)}")
    rng = np.random.default_rng(list(keyed(key, f"strata|{split}|{systems}|{n}")))
    n_none, n_out, n_pair = (round(share * n) for share in (NONE_SHARE, OUTSIDE_SHARE, PAIR_SHARE))
    singles = _spread(rng, list(WEIGHTS), list(WEIGHTS.values()), n - n_none - n_out - n_pair)
    outside = list(rng.permutation(np.resize(OUTSIDE, max(n_out, 1))))[:n_out]
    labels = [("none",)] * n_none + [(str(name),) for name in [*singles, *outside]] + [("pair",)] * n_pair
    where = [str(rng.choice(SYSTEMS[systems])) for _ in range(n)]
    noise = rng.permutation(np.resize(NOISE, n))
    long = rng.permutation(np.resize(DURATION_S, n))
    bins = rng.permutation(np.resize(list(BINS), n))
    out = []
    for k, label in enumerate(labels):
        forced = bool(rng.random() < 0.5)
        if label == ("pair",):
            label = _pair(rng, forced=forced)
            bins[k] = rng.choice(["middle", "high"])
        needs = bool(set(label) & set(NEEDS_INPUT))
        out.append(Stratum(label, where[k], forced or needs, float(noise[k]), float(long[k]), str(bins[k])))
    return [out[k] for k in rng.permutation(n)]


def is_camera(name: str) -> bool:
    """Whether an effect lies in the camera or the clock."""
    return name in CAMERA
