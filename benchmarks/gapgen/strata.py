"""Which recordings a split holds: labels in fixed shares, the rest balanced and shuffled by the key."""

import hashlib
import hmac

import numpy as np

from benchmarks.gapgen.controllers import CONTROLLED
from benchmarks.gapgen.drawing import BINS, Stratum
from benchmarks.gapgen.effect import CAMERA, FAMILIES, MACHINE, MEMORY, NEEDS_INPUT, OUTSIDE, OUTSIDE_WIDE
from benchmarks.gapgen.files import MOST_SAMPLES
from benchmarks.gapgen.mujoco_world import MUJOCO
from benchmarks.gapgen.sensors import COLOURED, QUANTISED, QUANTISED_NOISE, WHITE, Conditions, Sensor
from benchmarks.gapgen.sources import HELD_BACK, SOURCES, TEXTBOOK, source_of

NONE_SHARE, OUTSIDE_SHARE, PAIR_SHARE = 0.15, 0.12, 0.10
SYSTEMS = {
    "d1": ("pendulum", "rocker", "duffing_cart", "linear_cart"),
    "multi": ("two_link", "two_link", "bag", "soft_robot"),
    "d2": ("two_link", "bag"),
    "d4": ("soft_robot",),
}
SYSTEMS["to2"] = SYSTEMS["d1"] * 2 + SYSTEMS["d2"]
SYSTEMS["all"] = SYSTEMS["d1"] * 2 + ("two_link", "bag", "soft_robot")
SYSTEMS["calibration"] = SYSTEMS["d1"] * 2 + SYSTEMS["d2"] + MUJOCO + TEXTBOOK
SYSTEMS["held_back"] = HELD_BACK
# groups whose conditions are drawn wide
WIDE = ("calibration", "held_back")
WIDE_NONE_SHARE, WIDE_PAIR_SHARE = 0.20, 0.12
RATE_HZ, SPAN_S = (20.0, 1000.0), (4.0, 60.0)
# noise and step over the rms of the motion: encoders of 18 bits on a swing of 0.3 rad, to cameras
NOISE_LEVEL, STEP = (2e-5, 0.03), (8e-5, 0.02)
# gaps over the floor; at low noise they go on to a share of the motion
LEAST_RATIO, LEAST_PAIR_RATIO, MOST_RATIO, MOST_GAP = 1.2, 3.0, 40.0, 0.4
# nature's laws are never quite those of a catalogue: how often that shows, its share of the gap, and its gap
# over the floor where nothing is to be found
DISCREPANT, DISCREPANCY_SHARE, DISCREPANCY_ALONE = 0.6, (0.01, 0.2), (1.02, 1.3)
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
# a log has sensors and no camera
WIDE_WEIGHTS = {
    **{name: weight for name, weight in WEIGHTS.items() if name != "camera_change"},
    **dict.fromkeys(MACHINE, 1.0),
}
WIDE_GROUPS = (
    (*GROUPS[0], "position_dependent_damping", "asymmetric_friction"),
    (*GROUPS[1], "payload"),
    (*GROUPS[2], "torque_speed_limit"),
    (*GROUPS[3], "cogging", "parametric_stiffness"),
)
TWO = ("two_link", "bag", "mujoco_two_link", "mujoco_cart_pole", *TEXTBOOK, "rotational_actuator")
WHERE = {
    "circulatory_force": (*TWO, "elastic_joint", "quarter_car"),
    "base_motion": TWO,
    "controller_gain": CONTROLLED,
    # where weight is all that pulls, or nothing of the kind
    "mass_change": (
        "pendulum",
        "rocker",
        "linear_cart",
        "mujoco_pendulum",
        "mujoco_cart",
        "acrobot",
        "quarter_car",
    ),
    # where equations have a place for it at the first coordinate
    "payload": (*("pendulum", "linear_cart", "two_link", *TEXTBOOK), "rotational_actuator", *MUJOCO),
}
"""Systems that an effect of the wide groups is drawn on, where these are not all."""
CONTROLLED_SHARE = 0.15


def keyed(key: bytes, message: str) -> bytes:
    """HMAC-SHA256 of a message under the split's secret key."""
    return hmac.new(key, message.encode(), hashlib.sha256).digest()


def seed_of(key: bytes, identity: str) -> int:
    """Seed of a recording: nothing about it can be had from its name without the key."""
    return int.from_bytes(keyed(key, f"seed|{identity}")[:16], "big")


def identities(key: bytes, split: str, n: int) -> list[str]:
    """Random names of ``n`` recordings."""
    return [keyed(key, f"id|{split}|{k}").hex()[:12] for k in range(n)]


def _pair(
    rng: np.random.Generator, *, forced: bool, groups: tuple[tuple[str, ...], ...] = GROUPS
) -> tuple[str, str]:
    groups = [g for g in groups if forced or not set(g) & set(NEEDS_INPUT)]
    a, b = rng.choice(len(groups), 2, replace=False)
    return str(rng.choice(groups[a])), str(rng.choice(groups[b]))


def _spread(rng: np.random.Generator, names: list[str], weights: list[float], n: int) -> list[str]:
    """``n`` names in the shares of their weights as nearly as whole numbers allow."""
    share = np.array(weights) / np.sum(weights) * n
    count = np.floor(share).astype(int)
    if count.sum() < n:
        left = rng.choice(
            len(names), n - int(count.sum()), replace=False, p=(share - count) / (share - count).sum()
        )
        count[left] += 1
    return [name for name, c in zip(names, count, strict=True) for _ in range(c)]


def _log_uniform(rng: np.random.Generator, bounds: tuple[float, float]) -> float:
    return float(np.exp(rng.uniform(np.log(bounds[0]), np.log(bounds[1]))))


def _draw_sensor(rng: np.random.Generator, kind: str, *, loses: bool) -> tuple[Sensor, float]:
    """A sensor of a kind and the level of its noise over the rms of the motion."""
    correlation = float(rng.uniform(1.0, 10.0)) if kind == COLOURED else 0.0
    noise = QUANTISED_NOISE * _log_uniform(rng, STEP) if kind == QUANTISED else _log_uniform(rng, NOISE_LEVEL)
    lost = float(rng.uniform(0.002, 0.05)) if loses else 0.0
    longest = int(rng.integers(2, 25)) if loses and rng.random() < 0.5 else 1
    return Sensor(kind, correlation, lost, longest), noise


def _tolerance(rng: np.random.Generator, ratios: tuple[float, ...], *, exact: bool) -> float:
    """Gap over the floor that the nominal parameters alone leave."""
    ratio = float(rng.uniform(1.02, 1.3))
    if exact:
        return 1.0
    # where there is an effect, most of the gap comes from it
    return min([ratio, *(float(np.sqrt(1.0 + 0.15 * (r**2 - 1.0))) for r in ratios)])


def _discrepancy(rng: np.random.Generator, ratios: tuple[float, ...]) -> float:
    """Gap over the floor by which nature's laws differ from those of equations and catalogue."""
    # all drawn alike, so that the numbers after them do not depend on what shows
    shows = rng.random() < DISCREPANT
    share, alone = _log_uniform(rng, DISCREPANCY_SHARE), float(rng.uniform(*DISCREPANCY_ALONE))
    if not shows:
        return 1.0
    return float(np.hypot(1.0, share * np.sqrt(max(ratios) ** 2 - 1.0))) if ratios else alone


def _shares(rng: np.random.Generator, n: int, shares: dict[str, float]) -> list[str]:
    """``n`` names in exact shares, shuffled."""
    return [str(x) for x in rng.permutation(_spread(rng, list(shares), list(shares.values()), n))]


def _wide(key: bytes, split: str, n: int, systems: str) -> list[Stratum]:
    """Strata whose sources are balanced and whose conditions are drawn wide."""
    rng = np.random.default_rng(list(keyed(key, f"strata|{split}|{systems}|{n}")))
    n_none, n_out, n_pair = (round(x * n) for x in (WIDE_NONE_SHARE, OUTSIDE_SHARE, WIDE_PAIR_SHARE))
    singles = _spread(rng, list(WIDE_WEIGHTS), list(WIDE_WEIGHTS.values()), n - n_none - n_out - n_pair)
    outside = _shares(rng, n_out, dict.fromkeys(OUTSIDE_WIDE, 1.0))
    labels = [("none",)] * n_none + [(name,) for name in [*singles, *outside]] + [("pair",)] * n_pair
    there = {source_of(system) for system in SYSTEMS[systems]}
    sources = _shares(rng, n, {source: 1.0 for source in SOURCES if source in there})
    kinds = _shares(rng, n, {WHITE: 2.0, COLOURED: 1.0, QUANTISED: 1.0})
    losing, sine = (_shares(rng, n, {"yes": x, "no": 1.0 - x}) for x in (0.2, 0.1))
    out = []
    for k, label in enumerate(labels):
        forced = bool(rng.random() < 0.5)
        label = _pair(rng, forced=forced, groups=WIDE_GROUPS) if label == ("pair",) else label
        forced = forced or bool(set(label) & set(NEEDS_INPUT))
        system = str(
            rng.choice([x for x in SYSTEMS[systems] if source_of(x) == sources[k] and fits(x, label)])
        )
        # so that position control does not tell that its gains differ
        controlled = "controller_gain" in label or bool(rng.random() < CONTROLLED_SHARE)
        controlled = controlled and forced and system in CONTROLLED
        rate = _log_uniform(rng, RATE_HZ)
        span = min(_log_uniform(rng, SPAN_S), MOST_SAMPLES / rate)
        sensor, noise = _draw_sensor(rng, kinds[k], loses=losing[k] == "yes")
        bounds = LEAST_RATIO if len(label) == 1 else LEAST_PAIR_RATIO, max(MOST_RATIO, MOST_GAP / noise)
        ratios = tuple(_log_uniform(rng, bounds) for name in label if name != "none")
        discrepancy = 1.0 if label[0] in OUTSIDE_WIDE else _discrepancy(rng, ratios)
        # what nature alone leaves uses up the gap that parameters may leave where there is nothing to find
        tolerance = _tolerance(rng, ratios, exact=k % 2 == 0 or (not ratios and discrepancy > 1.0))
        sine_input = forced and sine[k] == "yes"
        conditions = Conditions(rate, sensor, ratios, tolerance, sine_input, controlled, discrepancy)
        out.append(Stratum(label, system, forced, noise, span, _bin_of(ratios), conditions))
    return [out[k] for k in rng.permutation(n)]


def fits(system: str, label: tuple[str, ...]) -> bool:
    """Whether a system of the wide groups has a place for all effects of a label."""
    return all(system in WHERE.get(name, (system,)) for name in label)


def _bin_of(ratios: tuple[float, ...]) -> str:
    """The bin of the largest ratio; the middle one where there is no effect."""
    top = max(ratios, default=5.0)
    return "low" if top < BINS["low"][1] else "middle" if top < BINS["middle"][1] else "high"


def strata(key: bytes, split: str, n: int, systems: str) -> list[Stratum]:
    """The strata of ``n`` recordings of a group of systems, in an order that only the key gives.

    Raises:
        ValueError: if the group of systems is unknown.
    """
    if systems not in SYSTEMS:
        raise ValueError(f"systems {systems!r}: none such; choose from {sorted(SYSTEMS)}")
    if systems in WIDE:
        return _wide(key, split, n, systems)
    rng = np.random.default_rng(list(keyed(key, f"strata|{split}|{systems}|{n}")))
    n_none, n_out, n_pair = (round(share * n) for share in (NONE_SHARE, OUTSIDE_SHARE, PAIR_SHARE))
    singles = _spread(rng, list(WEIGHTS), list(WEIGHTS.values()), n - n_none - n_out - n_pair)
    # as the splits that are out were drawn: with few recordings, the first kinds alone
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
