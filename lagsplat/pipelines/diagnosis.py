"""A diagnosis from two arguments to files on disk, for the command line and the workflow."""

import contextlib
import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any, get_args

import numpy as np

from lagsplat.diagnose.augmented.model import AugmentedSimulator, build_augmented, save_augmented
from lagsplat.diagnose.core.config import ERROR_BUDGET, VERDICT, DiagnoseConfig
from lagsplat.diagnose.core.result import Candidate, Diagnosis
from lagsplat.diagnose.data_quality.checks import DataCheck
from lagsplat.diagnose.data_quality.compatibility import MOSTLY_OUTSIDE_CHECK
from lagsplat.diagnose.data_quality.periodic_inputs import (
    estimate_common_period_s,
    estimate_input_period_s,
    wrap_shift,
)
from lagsplat.diagnose.diagnosis import DiagnosisRun, diagnose
from lagsplat.diagnose.effects.base import Component, InputEffect, SampleEffect
from lagsplat.diagnose.effects.registry import catalogue
from lagsplat.diagnose.estimation.dataset import sample_operating_region
from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator
from lagsplat.diagnose.inference.profile_likelihood import compute_profiles, compute_separability
from lagsplat.diagnose.inference.recalibration import (
    calibrate_null_evidence,
    choose_null_windows,
    separate_own_error,
)
from lagsplat.diagnose.residual.correlations import compute_residual_correlations
from lagsplat.diagnose.residual.error_budget import ErrorStage, PerceptionQuality, measure_error_stages
from lagsplat.diagnose.residual.latent_force import estimate_latent_force
from lagsplat.diagnose.residual.localization import ResidualLocation, locate
from lagsplat.io.files.atomic import write_text
from lagsplat.io.trajectory.trajectory import Trajectory, leading_samples
from lagsplat.pipelines.apply_diagnosis import AUGMENTED_FILE
from lagsplat.pipelines.diagnosis_follow_up import look_further
from lagsplat.pipelines.diagnosis_inputs import DiagnosisInputs, list_unseen, open_inputs_by_joint
from lagsplat.pipelines.diagnosis_progress import ProgressDisplay, count_steps
from lagsplat.pipelines.joint_diagnosis import (
    JOINT_INPUTS,
    diagnose_joints,
    patch_joints,
    save_joint_inputs,
)
from lagsplat.provenance import stamp
from lagsplat.report.diagnosis.content import ReportContent, save_next_inputs, save_rollouts
from lagsplat.report.diagnosis.html import render_report
from lagsplat.report.diagnosis.serialization import save_diagnosis

MAX_NOMINAL_PERIODS = 40
"""Natural periods of the sim's own trajectories that give the floors of the error budget."""


def prepare_search(
    inputs: DiagnosisInputs, config: DiagnoseConfig, *, report_progress: Callable[[str], None]
) -> tuple[EstimatedSimulator, DiagnoseConfig, float]:
    """The sim, the settings and the log evidence that effects gain by the sim's own errors [nat].

    They are adapted to the recordings: the sim's misfit to the windows that move alike. A sim's error on its
    own recordings counts as noise.
    """
    sim, reference, log_evidence_offset = inputs.sim, inputs.reference, 0.0
    if reference is not None:
        with contextlib.suppress(ValueError):  # the reference is too short for a window
            sim = separate_own_error(sim, choose_null_windows(sim, reference, inputs.real, config))
    config = _adapt_settings(replace(inputs, sim=sim), config)
    if inputs.null_motion is not None:
        with contextlib.suppress(ValueError):  # likewise
            log_evidence_offset = calibrate_null_evidence(
                sim, inputs.null_motion, inputs.real, config, report_progress=report_progress
            )
    return sim, config, log_evidence_offset


def run_diagnosis(
    inputs: DiagnosisInputs, config: DiagnoseConfig, *, report_progress: Callable[[str], None]
) -> DiagnosisRun:
    """Diagnose checked inputs, locate the gap, and say what to record next.

    Raises:
        ValueError: the motions are too short for a single window.
    """
    sim, config, log_evidence_offset = prepare_search(inputs, config, report_progress=report_progress)
    inputs = replace(inputs, sim=sim)
    image_quality = inputs.recordings.image_quality if inputs.recordings is not None else None
    run = diagnose(
        discount_image_error(sim, image_quality.perception if image_quality is not None else None),
        inputs.real,
        config,
        log_evidence_offset=log_evidence_offset,
        report_progress=report_progress,
        tolerances_are_causes=inputs.tolerances_are_causes,
    )
    report_progress("locate the gap")
    ratio = 0.0 if image_quality is None else image_quality.perception.ratio
    where = _locate(inputs, run, config, suspect=ratio > ERROR_BUDGET.suspect_error_ratio)
    nowhere = "The gap cannot be located: along the real motion the sim's forces are not finite."
    lost = () if where is not None else (nowhere,)
    diagnosis = replace(
        run.diagnosis,
        where=where,
        warnings=(*inputs.checked.warnings, *run.diagnosis.warnings, *lost),
        absorbed=inputs.absorbed,
        checks={
            **run.diagnosis.checks,
            "effective_sample_ratio": config.effective_sample_ratio,
            "sim_misfit": inputs.sim.misfit,
            **({"own_error": np.sqrt(sim.own_error).tolist()} if np.any(sim.own_error) else {}),
            "null_evidence": log_evidence_offset,
            "findings": [asdict(finding) for finding in inputs.checked.findings],
        },
    )
    diagnosis = wrap_time_shifts(diagnosis, inputs.real)
    if inputs.recordings is not None:
        diagnosis = inputs.recordings.judge(diagnosis)
    diagnosis = flag_extrapolation(diagnosis, inputs.checked)
    if inputs.checked.undetermined or "undetermined" in diagnosis.checks:
        diagnosis = withhold_verdict(diagnosis)
    return replace(run, diagnosis=diagnosis)


def _adapt_settings(inputs: DiagnosisInputs, config: DiagnoseConfig) -> DiagnoseConfig:
    """Adapt the settings to the sim: its priors, correlation and inputs, and effects that are ruled out."""
    ruled_out = list_unseen(film=inputs.recordings is not None)
    if inputs.recordings is not None:
        ruled_out = (*ruled_out, *inputs.recordings.ruled_out)
    config = replace(
        config,
        effective_sample_ratio=max(config.effective_sample_ratio, inputs.sim.correlation),
        input_hold=inputs.hold or config.input_hold,
        targets=dict(inputs.targets),
        without=[*config.without, *inputs.absorbed, *ruled_out],
    )
    if inputs.recordings is None:
        return config
    return config.scale_tolerances(config.learned_factor)


def discount_image_error(sim: EstimatedSimulator, perception: PerceptionQuality | None) -> EstimatedSimulator:
    """Raise the sim's misfit in proportion to the error of the real images over that of its own.

    An encoder with errors in the images has errors in the state, and they are smooth along the motion.
    """
    if perception is None or not perception.suspect:
        return sim
    return replace(sim, misfit=max(sim.misfit, 1.0) * max(perception.ratio, 1.0))


def _locate(
    inputs: DiagnosisInputs, run: DiagnosisRun, config: DiagnoseConfig, *, suspect: bool
) -> ResidualLocation | None:
    """Where the gap lies; None where the sim's forces are not finite along the real motion.

    The level is that of the verdict's leading effect, without one the likeliest, and perception where images
    are ``suspect``.
    """
    period_s, hold = run.diagnosis.checks["natural_period_s"], config.input_hold
    try:
        model, real = inputs.sim.model, inputs.real
        where = locate(model, real, period_s=period_s, hold=hold)
    except np.linalg.LinAlgError:
        return None
    level = "perception" if suspect else find_likeliest_level(run.diagnosis.candidates)
    if run.diagnosis.combination and run.chosen.effects:
        level = run.chosen.effects[0].effect.level
    return replace(where, level=level, components=share_components(run.diagnosis.candidates))


def find_likeliest_level(candidates: Sequence[Candidate]) -> str:
    """Find the level on the way from image to motion at which the likeliest causes act."""
    chances = {"dynamics": 0.0}
    for candidate in candidates:
        if (effect := catalogue().get(candidate.name)) is not None:
            chances[effect.level] = chances.get(effect.level, 0.0) + candidate.probability
    return max(chances, key=lambda level: chances[level])


def share_components(candidates: Sequence[Candidate]) -> dict[str, float]:
    """Share the probability of a cause among the kinds of term that effects change.

    "unexplained" is the share of an unknown cause; what is left is of sensors and clocks.
    """
    shares = dict.fromkeys((*get_args(Component), "unexplained"), 0.0)
    for candidate in candidates:
        effect = catalogue().get(candidate.name)
        component = "unexplained" if candidate.name == "unknown" else effect and effect.component
        if component:
            shares[component] += candidate.probability
    caused = 1.0 - sum(candidate.probability for candidate in candidates if candidate.name == "none")
    return {name: share / caused if caused > 0.0 else 0.0 for name, share in shares.items()}


def wrap_time_shifts(diagnosis: Diagnosis, real: Sequence[Trajectory]) -> Diagnosis:
    """Give shifts of periodic inputs within half a period of zero; whole periods more look the same."""
    periods_s = {name: estimate_input_period_s(real, i) for i, name in enumerate(diagnosis.u_names)}
    periods_s["all"] = estimate_common_period_s(real)

    def wrap(candidate: Candidate) -> Candidate:
        effect = catalogue().get(candidate.name)
        shift = effect.time_shift if isinstance(effect, InputEffect) else ""
        parameters = dict(candidate.parameters)
        for name, fitted in candidate.parameters.items() if shift else ():
            place = name.removeprefix(shift).strip() or candidate.input or "all"
            period_s = periods_s.get(place)
            if name.startswith(shift) and period_s is not None:
                moved = wrap_shift(fitted.value, period_s) - fitted.value
                low, high = (None if end is None else end + moved for end in (fitted.low, fitted.high))
                parameters[name] = replace(fitted, value=fitted.value + moved, low=low, high=high)
        return replace(candidate, parameters=parameters)

    return replace(diagnosis, candidates=tuple(wrap(candidate) for candidate in diagnosis.candidates))


def flag_extrapolation(diagnosis: Diagnosis, checked: DataCheck) -> Diagnosis:
    """Mark a verdict `unknown` as undetermined where the sim is extrapolated."""
    why = [finding.text for finding in checked.findings if finding.check == MOSTLY_OUTSIDE_CHECK]
    if diagnosis.verdict != "unknown" or not why:
        return diagnosis
    return replace(diagnosis, checks={**diagnosis.checks, "undetermined": why})


def withhold_verdict(diagnosis: Diagnosis) -> Diagnosis:
    """Withhold the verdict: no name exceeds `VERDICT.max_withheld_probability`, the rest is spread evenly."""
    top, even = diagnosis.candidates[0].probability, 1.0 / len(diagnosis.candidates)
    most = VERDICT.max_withheld_probability
    share = 1.0 if top <= most else max(most - even, 0.0) / (top - even)
    spread = (1.0 - share) * even
    flat = tuple(replace(c, probability=share * c.probability + spread) for c in diagnosis.candidates)
    return replace(diagnosis, verdict="undetermined", candidates=flat, combination=())


def diagnose_files(sim: str, real: str, out: Path, config: DiagnoseConfig, *, command: str) -> Diagnosis:
    """Write ``diagnosis.json``, ``rollouts.csv``, ``augmented.safetensors`` and ``report.html``.

    Checks of the data, progress and warnings are shown on stderr.

    Raises:
        OSError: ``out`` cannot be written to.
        FileNotFoundError, ValueError: as `open_diagnosis_inputs`; nothing is written then, and an older
            ``diagnosis.json`` in ``out`` is gone.
    """
    require_writable(out)
    (out / "diagnosis.json").unlink(missing_ok=True)  # an older one must not pass for this one
    with ProgressDisplay(config) as display, np.errstate(all="ignore"):
        # rollouts of a wrong hypothesis overflow; what is not finite is rejected where it is compared
        with warnings.catch_warnings(record=True) as caught:
            warnings.simplefilter("always")
            parts, runs, leader, content = _diagnose_arguments(sim, real, config, display)
        inputs, run = parts[leader], runs[leader]
        # warnings for programmers are dropped
        texts = [str(each.message) for each in caught if each.category is UserWarning]
        new = [text for text in dict.fromkeys(texts) if text not in run.diagnosis.warnings]
        diagnosis = replace(run.diagnosis, warnings=(*run.diagnosis.warnings, *new))
        for text in diagnosis.warnings:
            display.warn(f"warning: {text}")
    out.mkdir(parents=True, exist_ok=True)
    settings: dict[str, Any] = {"sim": sim, "real": real, "config": asdict(config), "stamp": stamp()}
    augmented = build_augmented_simulator(inputs, run)
    save_augmented(out / AUGMENTED_FILE, augmented, settings)
    if inputs.joint is None:
        diagnosis = write_mujoco_patch(sim, out / "patched.xml", augmented, diagnosis, config)
    else:
        diagnosis = write_joint_files(sim, out, parts, runs, diagnosis, config)
    # written even without blocks, so that no older file passes for this one's
    save_rollouts(out / "rollouts.csv", diagnosis.blocks, q_names=diagnosis.q_names)
    save_next_inputs(out, diagnosis)
    page = render_report(diagnosis, replace(content, command=command, stamp=stamp()))
    write_text(out / "report.html", page)
    save_diagnosis(out / "diagnosis.json", diagnosis)
    return diagnosis


def _diagnose_arguments(
    sim: str, real: str, config: DiagnoseConfig, display: ProgressDisplay
) -> tuple[Sequence[DiagnosisInputs], Sequence[DiagnosisRun], int, ReportContent]:
    """Inputs and runs, one of each for every joint that is diagnosed by itself, and which of them leads."""

    def show_checks(checked: DataCheck) -> None:
        display.show_checks(checked)
        display("prepare the sim")

    def show_fit(text: str) -> None:
        display.warn(text)
        display("fit the sim's film")

    def run_one(part: DiagnosisInputs, report: Callable[[str], None]) -> DiagnosisRun:
        return run_diagnosis(part, config, report_progress=report)

    parts = open_inputs_by_joint(sim, real, config, show_checks=show_checks, show_fit=show_fit)
    try:
        if parts[0].joint is None:
            runs, leader = [run_one(parts[0], display)], 0
        else:
            display("search joint by joint", len(parts) * count_steps(config))
            runs, leader = diagnose_joints(parts, run_one, report_progress=display)
    except ValueError as error:
        reason = str(error)
        if isinstance(error, np.linalg.LinAlgError) or "infs or NaNs" in reason:
            reason = "The sim cannot follow the real motions, its numbers overflow; check units and signs"
        raise ValueError(" ".join([*parts[0].checked.warnings, reason])) from error
    inputs, run = parts[leader], runs[leader]
    display("plan the next experiment", 2)
    run = look_further(inputs, run, config)
    display("draw the figures", 1)
    content = build_report_content(inputs, run)
    if inputs.recordings is not None:
        from lagsplat.pipelines.diagnosis_images import add_images

        display("compare the images", 1)
        run, content = add_images(inputs, run, content)
    runs[leader] = run
    return parts, runs, leader, content


def require_writable(out: Path) -> None:
    """Check that results can be written to ``out``, before minutes are spent on them.

    Raises:
        OSError: ``out`` is a file, lies below one, or cannot be written to.
    """
    place = next(place for place in (out, *out.absolute().parents) if place.exists())
    if not place.is_dir():
        raise NotADirectoryError(f"out={out}: {place} is a file; name another folder")
    if not os.access(place, os.W_OK):
        raise PermissionError(f"out={out}: {place} cannot be written to; name another folder")


def write_mujoco_patch(
    sim: str, out: Path, augmented: AugmentedSimulator, diagnosis: Diagnosis, config: DiagnoseConfig
) -> Diagnosis:
    """Write a MuJoCo sim's file with the effects that MuJoCo can express; ``checks`` lists them."""
    if Path(sim).suffix.lower() not in (".xml", ".mjcf", ".urdf") or not augmented.effects:
        return diagnosis
    from lagsplat.diagnose.augmented.mujoco_export import patch_augmented

    changes = patch_augmented(Path(sim), out, augmented, **config.model_choice)
    lines = list(changes) or ["MuJoCo has no counterpart of what was found; the file was left as it is"]
    return replace(diagnosis, checks={**diagnosis.checks, "mujoco": lines})


def write_joint_files(
    sim: str,
    out: Path,
    parts: Sequence[DiagnosisInputs],
    runs: Sequence[DiagnosisRun],
    diagnosis: Diagnosis,
    config: DiagnoseConfig,
) -> Diagnosis:
    """Write the changed MuJoCo file, and the computed inputs of the joint that leads."""
    named = next(part for part in parts if part.joint and part.joint.joint == diagnosis.q_names[0])
    save_joint_inputs(out / JOINT_INPUTS, named)
    found = [
        (part, build_augmented_simulator(part, run))
        for part, run in zip(parts, runs, strict=True)
        if run.diagnosis.verdict == "effect"
    ]
    note = (
        f"{AUGMENTED_FILE} is joint {diagnosis.q_names[0]} alone, the other joints moving as recorded; its "
        f"inputs {', '.join(diagnosis.u_names)} are in {JOINT_INPUTS}"
    )
    checks = {**diagnosis.checks, "augmented": [note]}
    if found:
        checks["mujoco"] = patch_joints(Path(sim), out / "patched.xml", found, parameters=config.parameters)
    return replace(diagnosis, checks=checks)


def build_augmented_simulator(inputs: DiagnosisInputs, run: DiagnosisRun) -> AugmentedSimulator:
    """The sim with the chosen effects, or with its refitted parameters alone."""
    rollout_model, real = run.problem.rollout_model, inputs.real[0]
    return build_augmented(
        rollout_model,
        [effect for effect in run.chosen.effects if not isinstance(effect.effect, SampleEffect)],
        run.chosen.fit.x,
        q_names=real.q_names,
        u_names=real.u_names,
        region=sample_operating_region(rollout_model.dataset),
    )


def build_report_content(inputs: DiagnosisInputs, run: DiagnosisRun) -> ReportContent:
    """Content of the report beside the verdict: error budget, correlations, separability and profiles."""
    inflation, real, where = run.ranking.noise_inflation, inputs.real[0], run.diagnosis.where
    q_names, u_names = real.q_names, real.u_names
    correlations = where and compute_residual_correlations(where.smoothed, q_names=q_names, u_names=u_names)
    return ReportContent(
        stages=compute_error_stages(inputs, run),
        correlations=correlations,
        separability=compute_separability(run.problem, run.ranking.found, noise_inflation=inflation),
        profiles=tuple(compute_profiles(run.problem, run.chosen, noise_inflation=inflation)),
    )


def compute_error_stages(inputs: DiagnosisInputs, run: DiagnosisRun) -> tuple[ErrorStage, ...]:
    """The error budget; its floors are the errors on the sim's own trajectories.

    Empty where the residual could not be estimated.
    """
    if run.diagnosis.where is None:
        return ()
    period_s = float(run.diagnosis.checks["natural_period_s"])
    nominal = None
    if inputs.checked.sim is not None:
        part, left_s = [], MAX_NOMINAL_PERIODS * period_s
        for motion in inputs.checked.sim.motions:
            if left_s > 0.0:
                part.append(leading_samples(motion, left_s))
                left_s -= part[-1].duration_s
        hold = "zoh" if run.problem.rollout_model.held else "linear"
        with contextlib.suppress(np.linalg.LinAlgError):  # the sim diverges even on its own trajectories
            nominal = estimate_latent_force(inputs.sim.model, part, period_s=period_s, hold=hold)
    quality = None if inputs.recordings is None else inputs.recordings.image_quality
    return measure_error_stages(
        inputs.sim.model,
        run.diagnosis.where.smoothed,
        nominal,
        horizon_s=period_s,
        image_errors=None if quality is None else (quality.error_real, quality.error_nominal),
        block=10,
    )
