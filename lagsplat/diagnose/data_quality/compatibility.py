"""Whether simulator and recording have the same coordinates and inputs, and move in the same region."""

from collections.abc import Sequence

import numpy as np

from lagsplat.diagnose.core.config import COMPATIBILITY
from lagsplat.diagnose.core.result import Finding
from lagsplat.io.trajectory.trajectory import Trajectory

MOSTLY_OUTSIDE_CHECK = "mostly outside the sim"
"""Name of the check for recordings that lie mostly outside the region of the simulator's data, where an
unexplained residual may be the simulator's own error."""
UNIT_RATIOS = {
    180.0 / np.pi: "degrees and radians",
    1000.0: "millimetres and metres",
    100.0: "centimetres and metres",
    25.4: "inches and millimetres",
    2.0 * np.pi: "turns and radians",
    360.0: "turns and degrees",
}
"""Ratios of units that are often confused."""


def check_coordinates(sim: Sequence[Trajectory], real: Sequence[Trajectory]) -> list[Finding]:
    """Check that numbers and names of coordinates and inputs agree, within each side and between them.

    An input that only the real side has leaves the verdict undetermined where it moves, because the simulator
    does not model it. One that only the simulator has is refused, because its real values are unknown.
    """
    findings = []
    first = (*sim, *real)[0]
    for motion in (*sim, *real):
        if motion.q_names != first.q_names:
            here, there = ", ".join(motion.q_names), ", ".join(first.q_names)
            what = f"coordinates {here}, but {first.source} has {there}"
            why = "the sim and the real thing must be described by the same coordinates"
            remedy = "give the same columns on both sides, or name them with diagnose.columns={q0: NAME}"
            findings.append(
                Finding("refuse", "coordinates", motion.source, what, why, remedy, motion.q_names)
            )
    sides = {"sim": sim, "real": real}
    names = {side: {name for motion in motions for name in motion.u_names} for side, motions in sides.items()}
    missing = [
        (motion.source, sorted(names[side] - set(motion.u_names)), f"other files of {side} have it")
        for side, motions in sides.items()
        for motion in motions
    ]
    extra = []
    if sim and real:
        missing.append(("real", sorted(names["sim"] - names["real"]), "the sim is driven by it"))
        extra = sorted(names["real"] - names["sim"])
    for source, lacking, why in missing:
        if lacking:
            what, remedy = f"no input {', '.join(lacking)}", "add the column, with zeros if nothing acted"
            findings.append(Finding("refuse", "missing input", source, what, why, remedy, tuple(lacking)))
    having = {name: [motion for motion in real if name in motion.u_names] for name in extra}
    moving = tuple(name for name in extra if any(_input_moves([m], name, 1e-9) for m in having[name]))
    if moving:
        what = f"{', '.join(moving)} moves, and the sim has no such input"
        why = "whatever it does would pass for an effect"
        remedy = "record the sim with this input, or leave the column out if it does not act"
        findings.append(Finding("undetermined", "input of one side", "real", what, why, remedy, moving))
    elif extra:
        what = f"{', '.join(extra)} is constant, and the sim has no such input"
        why = "a constant input shows as a constant force at most"
        remedy = "leave the column out if it does not act"
        findings.append(Finding("note", "input of one side", "real", what, why, remedy, tuple(extra)))
    return findings


def check_inputs(sim: Sequence[Trajectory], real: Sequence[Trajectory]) -> list[Finding]:
    """Report inputs that are constant on the real side, and those that move only there.

    The latter leave the verdict undetermined: a simulator that never saw an input move does not know its
    effect.
    """
    findings = []
    tolerance = COMPATIBILITY.constant_tolerance
    for name in real[0].u_names:
        if sim and name not in sim[0].u_names:
            continue
        if not _input_moves(real, name, tolerance):
            what = f"{name} is constant"
            why = "lag, delay, dead zone, saturation, play and gain of it cannot be seen"
            remedy = "move it through zero, slowly and fast, if such effects are in question"
            findings.append(Finding("warn", "constant input", "real", what, why, remedy, (name,)))
        elif sim and not _input_moves(sim, name, tolerance):
            what = f"{name} moves, and is constant in the sim"
            why = "the sim does not tell what this input does, which would pass for an effect"
            remedy = "record the sim with this input moving"
            findings.append(Finding("undetermined", "input of one side", "real", what, why, remedy, (name,)))
    return findings


def _input_moves(motions: Sequence[Trajectory], name: str, tolerance: float) -> bool:
    """Whether the named input varies by more than ``tolerance`` of its largest value."""
    values = np.concatenate([motion.u[:, motion.u_names.index(name)] for motion in motions])
    return bool(np.ptp(values) > tolerance * np.abs(values).max())


def check_region(sim: Sequence[Trajectory], real: Sequence[Trajectory]) -> list[Finding]:
    """Check that the real motion lies in the region of the simulator's data, and has the same units.

    Distances are Mahalanobis', with the simulator's median and a covariance from rank correlations, so that a
    few outliers do not matter.
    """
    if not sim:
        return []
    nominal = np.concatenate([motion.q for motion in sim])
    measured = np.concatenate([motion.q for motion in real])
    findings = []
    for name, sim_column, real_column in zip(sim[0].q_names, nominal.T, measured.T, strict=True):
        findings += _check_units(sim_column, real_column, name)
    centre, root = _estimate_robust_cloud(nominal)
    reach = np.quantile(np.linalg.norm((nominal - centre) @ root, axis=1), 0.99)
    distance = np.linalg.norm((measured - centre) @ root, axis=1)
    outside = float((distance > COMPATIBILITY.region_factor * reach).mean())
    off = float(np.linalg.norm((np.median(measured, axis=0) - centre) @ root))
    middle = off / max(float(reach), 1e-6 * off, np.finfo(float).tiny)
    what = f"{100 * outside:.3g} % of the real samples lie outside the region the sim was seen in"
    mostly = outside > COMPATIBILITY.undetermined_outside_share
    if mostly and middle > COMPATIBILITY.max_center_offset / 3.0:
        what += f", and their middle {middle:.2g} times as far out as the sim ever was"
        why = "the sim says nothing of that region"
        remedy = "check zero points, signs and units of both sides, or give a sim of that region"
        findings.append(Finding("undetermined", "no overlap", "real", what, why, remedy))
    elif outside > COMPATIBILITY.warning_outside_share:
        check = MOSTLY_OUTSIDE_CHECK if mostly else "outside the sim"
        why = "there the sim is extrapolated, and its own error passes for an effect"
        remedy = "give a sim of larger motions, or real motions as large as the sim's"
        findings.append(Finding("warn", check, "real", what, why, remedy))
    return findings


def _estimate_robust_cloud(cloud: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Median, and a root of the inverse covariance, from rank correlations and quantiles."""
    centre = np.median(cloud, axis=0)
    low, high = np.quantile(cloud, [0.02, 0.98], axis=0)
    rounding = 1e-9 * np.maximum(np.abs(cloud).max(axis=0), 1e-290)
    spread = np.maximum(0.25 * (high - low), rounding)
    ranks = cloud.argsort(axis=0).argsort(axis=0)
    # Spearman's correlation; some of the identity keeps it invertible where coordinates move together.
    correlation = np.corrcoef(ranks.T).reshape(len(centre), len(centre))
    correlation = np.where(np.isfinite(correlation), correlation, 0.0)
    np.fill_diagonal(correlation, 1.0)
    correlation = 0.95 * correlation + 0.05 * np.eye(len(centre))
    values, vectors = np.linalg.eigh(correlation * np.outer(spread, spread))
    return centre, vectors / np.sqrt(np.maximum(values, 1e-300))


def _check_units(sim: np.ndarray, real: np.ndarray, name: str) -> list[Finding]:
    """Finding of a probable difference of units, where sizes differ by a large factor."""
    sizes = [float(np.quantile(np.abs(side - np.median(side)), 0.98)) for side in (sim, real)]
    if min(sizes) <= 0.0:
        return []
    ratio = sizes[1] / sizes[0]
    if 1.0 / COMPATIBILITY.striking_size_ratio < ratio < COMPATIBILITY.striking_size_ratio:
        return []
    distances = {unit: abs(np.log(max(ratio, 1.0 / ratio) / unit)) for unit in UNIT_RATIOS}
    likeliest = min(UNIT_RATIOS, key=lambda unit: distances[unit])
    plausible = distances[likeliest] < COMPATIBILITY.unit_ratio_tolerance
    level = "undetermined" if ratio > 1.0 or plausible else "warn"
    what = f"{name} moves {ratio:.3g} times as far as in the sim"
    if plausible:
        what += f", about the ratio of {UNIT_RATIOS[likeliest]}"
    why = "the sim was never seen at that size, or the units differ"
    remedy = "give both sides in one unit, or a sim that moves as far as the real thing"
    return [Finding(level, "units", "real", what, why, remedy, (name,))]
