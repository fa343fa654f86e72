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
            findings.append(
                Finding(
                    "refuse",
                    "coordinates",
                    motion.source,
                    f"coordinates {', '.join(motion.q_names)}, but {first.source} has "
                    f"{', '.join(first.q_names)}",
                    "the sim and the real thing must be described by the same coordinates",
                    "give the same columns on both sides, or name them with diagnose.columns={q0: NAME}",
                    motion.q_names,
                )
            )
    sides = {"sim": sim, "real": real}
    names = {side: {name for motion in motions for name in motion.u_names} for side, motions in sides.items()}
    for side, motions in sides.items():
        for motion in motions:
            lacking = sorted(names[side] - set(motion.u_names))
            if lacking:
                findings.append(
                    _report_missing_input(motion.source, lacking, f"other files of {side} have it")
                )
    if sim and real and (lacking := sorted(names["sim"] - names["real"])):
        findings.append(_report_missing_input("real", lacking, "the sim is driven by it"))
    extra = sorted(names["real"] - names["sim"]) if sim and real else []
    moving = [name for name in extra if any(_input_moves(motion, name) for motion in real)]
    if moving:
        findings.append(
            Finding(
                "undetermined",
                "input of one side",
                "real",
                f"{', '.join(moving)} moves, and the sim has no such input",
                "whatever it does would pass for an effect",
                "record the sim with this input, or leave the column out if it does not act",
                tuple(moving),
            )
        )
    elif extra:
        findings.append(
            Finding(
                "note",
                "input of one side",
                "real",
                f"{', '.join(extra)} is constant, and the sim has no such input",
                "a constant input shows as a constant force at most",
                "leave the column out if it does not act",
                tuple(extra),
            )
        )
    return findings


def _report_missing_input(source: str, names: Sequence[str], why: str) -> Finding:
    """The finding of inputs that ``source`` lacks."""
    return Finding(
        "refuse",
        "missing input",
        source,
        f"no input {', '.join(names)}",
        why,
        "add the column, with zeros if nothing acted",
        tuple(names),
    )


def _input_moves(motion: Trajectory, name: str) -> bool:
    """Whether the named input is more than a constant."""
    column = motion.u[:, motion.u_names.index(name)]
    return bool(np.ptp(column) > 1e-9 * np.abs(column).max())


def check_region(sim: Sequence[Trajectory], real: Sequence[Trajectory]) -> list[Finding]:
    """Check that the real motion lies in the region of the simulator's data, and has the same units.

    Distances are Mahalanobis', with the simulator's median and a covariance from rank correlations, so that a
    few outliers do not matter.
    """
    if not sim or not real or sim[0].d != real[0].d:
        return []
    nominal = np.concatenate([motion.q for motion in sim])
    measured = np.concatenate([motion.q for motion in real])
    findings = [
        finding
        for i in range(sim[0].d)
        if (finding := _check_units(nominal[:, i], measured[:, i], sim[0].q_names[i]))
    ]
    centre, root = _estimate_robust_cloud(nominal)
    reach = np.quantile(np.linalg.norm((nominal - centre) @ root, axis=1), 0.99)
    distance = np.linalg.norm((measured - centre) @ root, axis=1)
    outside = float((distance > COMPATIBILITY.region_factor * reach).mean())
    off = float(np.linalg.norm((np.median(measured, axis=0) - centre) @ root))
    middle = off / max(float(reach), 1e-6 * off, np.finfo(float).tiny)
    if outside > COMPATIBILITY.undetermined_outside_share and middle > COMPATIBILITY.max_center_offset / 3.0:
        findings.append(
            Finding(
                "undetermined",
                "no overlap",
                "real",
                f"{100 * outside:.3g} % of the real samples lie outside the region the sim was seen in, and "
                f"their middle {middle:.2g} times as far out as the sim ever was",
                "the sim says nothing of that region",
                "check zero points, signs and units of both sides, or give a sim of that region",
            )
        )
    elif outside > COMPATIBILITY.warning_outside_share:
        findings.append(
            Finding(
                "warn",
                MOSTLY_OUTSIDE_CHECK
                if outside > COMPATIBILITY.undetermined_outside_share
                else "outside the sim",
                "real",
                f"{100 * outside:.3g} % of the real samples lie outside the region the sim was seen in",
                "there the sim is extrapolated, and its own error passes for an effect",
                "give a sim of larger motions, or real motions as large as the sim's",
            )
        )
    return findings


def _estimate_robust_cloud(cloud: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Median, and a root of the inverse covariance, from rank correlations and quantiles."""
    centre = np.median(cloud, axis=0)
    spread = _estimate_robust_spread(cloud)
    ranks = cloud.argsort(axis=0).argsort(axis=0)
    # Spearman's correlation; some of the identity keeps it invertible where coordinates move together.
    correlation = np.corrcoef(ranks.T).reshape(len(centre), len(centre))
    correlation = np.where(np.isfinite(correlation), correlation, 0.0)
    np.fill_diagonal(correlation, 1.0)
    correlation = 0.95 * correlation + 0.05 * np.eye(len(centre))
    values, vectors = np.linalg.eigh(correlation * np.outer(spread, spread))
    return centre, vectors / np.sqrt(np.maximum(values, 1e-300))


def _estimate_robust_spread(cloud: np.ndarray) -> np.ndarray:
    """A quarter of the range of the central 96 % of each column, at least a rounding error."""
    low, high = np.quantile(cloud, [0.02, 0.98], axis=0)
    return np.maximum(0.25 * (high - low), 1e-9 * np.maximum(np.abs(cloud).max(axis=0), 1e-290))


def _check_units(sim: np.ndarray, real: np.ndarray, name: str) -> Finding | None:
    """Finding of a probable difference of units, where sizes differ by a large factor; else None."""
    sizes = [float(np.quantile(np.abs(side - np.median(side)), 0.98)) for side in (sim, real)]
    if min(sizes) <= 0.0:
        return None
    ratio = sizes[1] / sizes[0]
    if 1.0 / COMPATIBILITY.striking_size_ratio < ratio < COMPATIBILITY.striking_size_ratio:
        return None
    factor = min(UNIT_RATIOS, key=lambda unit: abs(np.log(max(ratio, 1.0 / ratio) / unit)))
    plausible = abs(np.log(max(ratio, 1.0 / ratio) / factor)) < COMPATIBILITY.unit_ratio_tolerance
    return Finding(
        "undetermined" if ratio > 1.0 or plausible else "warn",
        "units",
        "real",
        f"{name} moves {ratio:.3g} times as far as in the sim"
        + (f", about the ratio of {UNIT_RATIOS[factor]}" if plausible else ""),
        "the sim was never seen at that size, or the units differ",
        "give both sides in one unit, or a sim that moves as far as the real thing",
        (name,),
    )
