"""One diagnosis of a chain whose joints were diagnosed one by one."""

from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
import pandas as pd

from lagsplat.diagnose.augmented.model import AugmentedSimulator
from lagsplat.diagnose.augmented.mujoco_export import patch_augmented
from lagsplat.diagnose.core.result import Candidate, Diagnosis
from lagsplat.diagnose.diagnosis import DiagnosisRun
from lagsplat.io.files.atomic import replace_atomically
from lagsplat.pipelines.diagnosis_inputs import DiagnosisInputs

JOINT_INPUTS = "joint_inputs.csv"
ORDER = ("effect", "unknown", "undetermined", "none")
"""Verdicts in the order in which a joint's leads."""


def diagnose_joints(
    parts: Sequence[DiagnosisInputs],
    run_joint: Callable[[DiagnosisInputs, Callable[[str], None]], DiagnosisRun],
    *,
    report_progress: Callable[[str], None],
) -> tuple[list[DiagnosisRun], int]:
    """Diagnose every joint by itself, and choose the one that leads.

    Args:
        parts: the joints.
        run_joint: diagnoses one of them, given what is called with the name of each step.
        report_progress: called with the joint and the step.

    Raises:
        ValueError: the motion of a joint is too short for a single window.
    """
    runs = []
    for part in parts:
        name = name_joint(part)

        def report(step: str, name: str = name) -> None:
            report_progress(f"{name}: {step}")

        runs.append(run_joint(part, report))
    leader = min(range(len(runs)), key=lambda i: rank_joint(runs[i].diagnosis))
    rows = [summarize_joint(part, run) for part, run in zip(parts, runs, strict=True)]
    lead = runs[leader].diagnosis
    runs[leader] = replace(runs[leader], diagnosis=replace(lead, checks={**lead.checks, "joints": rows}))
    return runs, leader


def name_joint(part: DiagnosisInputs) -> str:
    """The name of the joint that these inputs are of."""
    assert part.joint is not None
    return part.joint.joint


def rank_joint(diagnosis: Diagnosis) -> tuple[int, float]:
    """Sort key: effects first, then what has no name, then none; the largest gap over its floor first."""
    gap = diagnosis.gap
    ratio = gap.before / gap.floor if gap is not None and gap.floor > 0.0 else 0.0
    return ORDER.index(diagnosis.verdict), -ratio if np.isfinite(ratio) else 0.0


def summarize_joint(part: DiagnosisInputs, run: DiagnosisRun) -> dict[str, Any]:
    """The verdict on one joint as plain data: effects with their parameters, and the gap."""
    diagnosis = run.diagnosis
    known = {candidate.name: candidate for candidate in diagnosis.candidates}
    gap = diagnosis.gap
    sizes = {name: getattr(gap, name) if gap else None for name in ("before", "refit", "after", "floor")}
    return {
        "joint": name_joint(part),
        "verdict": diagnosis.verdict,
        "probability": diagnosis.candidates[0].probability,
        "effects": [_describe_candidate(known[name]) for name in diagnosis.combination],
        **sizes,
        "sim_misfit": diagnosis.checks["sim_misfit"],
        "misfit_none": diagnosis.checks["misfit_none"],
    }


def _describe_candidate(candidate: Candidate) -> dict[str, Any]:
    parameters = {name: asdict(parameter) for name, parameter in candidate.parameters.items()}
    return {
        "name": candidate.name,
        "coordinate": candidate.coordinate,
        "input": candidate.input,
        "parameters": parameters,
    }


def save_joint_inputs(path: Path, part: DiagnosisInputs) -> None:
    """Write the inputs of a joint's own simulator, of which all but the torque were computed.

    Raises:
        OSError: the file cannot be written.
    """
    motion = part.real[0]
    columns = {"t": motion.time_s} | {f"u{i}": column for i, column in enumerate(motion.u.T)}
    with replace_atomically(path) as temporary:
        pd.DataFrame(columns).to_csv(temporary, index=False)


def patch_joints(
    sim: Path,
    out: Path,
    found: Sequence[tuple[DiagnosisInputs, AugmentedSimulator]],
    *,
    parameters: str | None = None,
) -> list[str]:
    """Write a MuJoCo file with what was found at each joint, and list the changes, for people.

    What MuJoCo cannot express is listed as left out; a file is written if there is anything else.
    """
    lines: list[str] = []
    present = sim
    for part, augmented in found:
        joint = part.joint
        assert joint is not None
        names = {"joints": [joint.joint], "actuators": [joint.actuator]}
        given = parameters if present == sim else None  # a patched file has them already
        changes = patch_augmented(present, out, augmented, **names, parameters=given, inertia=joint.inertia)
        lines += changes or [f"joint {joint.joint}: MuJoCo has no counterpart of what was found there"]
        present = out if changes else present
    return lines
