"""A diagnosis from two arguments to files on disk, for the command line and the workflow."""

import contextlib
import os
import warnings
from collections.abc import Callable, Sequence
from dataclasses import asdict, replace
from pathlib import Path
from typing import Any

import numpy as np
from tqdm import tqdm

from lagsplat.diagnose.augmented.model import AugmentedSimulator, build_augmented, save_augmented
from lagsplat.diagnose.core.config import VERDICT, DiagnoseConfig
from lagsplat.diagnose.core.result import Diagnosis
from lagsplat.diagnose.data_quality.checks import DataCheck
from lagsplat.diagnose.data_quality.compatibility import MOSTLY_OUTSIDE_CHECK
from lagsplat.diagnose.diagnosis import DiagnosisRun, diagnose
from lagsplat.diagnose.effects.base import SampleEffect
from lagsplat.diagnose.effects.registry import list_effects
from lagsplat.diagnose.estimation.dataset import sample_operating_region
from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator
from lagsplat.diagnose.inference.problem import measure_misfit
from lagsplat.diagnose.inference.profile_likelihood import compute_profiles, compute_separability
from lagsplat.diagnose.inference.recalibration import calibrate_null_evidence, match_windows
from lagsplat.diagnose.residual.components import compute_residual_correlations
from lagsplat.diagnose.residual.error_budget import ErrorStage, PerceptionQuality, measure_error_stages
from lagsplat.diagnose.residual.latent_force import estimate_latent_force
from lagsplat.diagnose.residual.localization import ResidualLocation, locate
from lagsplat.io.trajectory.trajectory import Trajectory, leading_samples
from lagsplat.pipelines.apply_diagnosis import AUGMENTED_FILE
from lagsplat.pipelines.diagnosis_inputs import LAWLESS, DiagnosisInputs, open_diagnosis_inputs
from lagsplat.provenance import stamp
from lagsplat.report.diagnosis.content import ReportContent, save_rollouts
from lagsplat.report.diagnosis.html import save_report
from lagsplat.report.diagnosis.serialization import save_diagnosis

NOWHERE = "The gap cannot be located: along the real motion the sim's forces are not finite."
MAX_NOMINAL_PERIODS = (
    40  # natural periods of the sim's own trajectories that give the floors of the error budget
)


def run_diagnosis(
    inputs: DiagnosisInputs, config: DiagnoseConfig, *, report_progress: Callable[[str], None]
) -> DiagnosisRun:
    """Diagnose checked inputs, locate the gap, and say what to record next.

    Raises:
        ValueError: the motions are too short for a single window.
    """
    null_motion = inputs.null_motion
    inputs = _match_misfit(inputs, null_motion, config)
    config = _adapt_settings(inputs, config)
    log_evidence_offset = 0.0
    with contextlib.suppress(ValueError):  # a reference that is too short has no windows
        if null_motion is not None:
            log_evidence_offset = calibrate_null_evidence(
                inputs.sim, null_motion, inputs.real, config, report_progress=report_progress
            )
    image_quality = inputs.recordings.image_quality if inputs.recordings is not None else None
    seen = image_quality.perception if image_quality is not None else None
    found = diagnose(
        discount_image_error(inputs.sim, seen),
        inputs.real,
        config,
        log_evidence_offset=log_evidence_offset,
        report_progress=report_progress,
    )
    report_progress("where")
    where = _locate(inputs, found, config, suspect=image_quality is not None and image_quality.drawn_badly)
    diagnosis = replace(
        found.diagnosis,
        where=where,
        warnings=(
            *inputs.checked.warnings,
            *found.diagnosis.warnings,
            *((NOWHERE,) if where is None else ()),
        ),
        excitation=tuple(f"{row.effect}: {row.record}" for row in inputs.excitation if row.record),
        absorbed=list_absorbed_effects() if inputs.same_recording else (),
        checks={
            **found.diagnosis.checks,
            "samples_as_one": config.effective_sample_ratio,
            "sim_misfit": inputs.sim.misfit,
            "null_evidence": log_evidence_offset,
            "excitation": [asdict(row) for row in inputs.excitation],
            "findings": [asdict(finding) for finding in inputs.checked.findings],
        },
    )
    if inputs.recordings is not None:
        diagnosis = inputs.recordings.judge(diagnosis)
    diagnosis = flag_extrapolation(diagnosis, inputs.checked)
    if inputs.checked.undetermined or "undetermined" in diagnosis.checks:
        diagnosis = withhold_verdict(diagnosis)
    return replace(found, diagnosis=diagnosis)


def _locate(
    inputs: DiagnosisInputs, found: DiagnosisRun, config: DiagnoseConfig, *, suspect: bool
) -> ResidualLocation | None:
    """Where the gap lies; None where the sim's forces are not finite along the real motion."""
    period_s = found.diagnosis.checks["natural_period_s"]
    try:
        where = locate(
            inputs.sim.model,
            inputs.real,
            period_s=period_s,
            hold=config.input_hold,
            perception_suspect=suspect,
        )
    except np.linalg.LinAlgError:
        return None
    if found.diagnosis.combination and found.chosen.effects:
        return locate_with_verdict(where, found)
    return where


def _match_misfit(
    inputs: DiagnosisInputs, null_motion: Trajectory | None, config: DiagnoseConfig
) -> DiagnosisInputs:
    """Measure the sim's misfit on reference windows like the real ones, where the sim has a novelty
    detector."""
    if null_motion is None or inputs.sim.novelty_detector is None:
        return inputs
    try:
        problem = match_windows(inputs.sim, null_motion, inputs.real, config)
        return replace(inputs, sim=measure_misfit(inputs.sim, problem))
    except ValueError:  # the reference is too short for a window
        return inputs


def discount_image_error(sim: EstimatedSimulator, seen: PerceptionQuality | None) -> EstimatedSimulator:
    """Raise the sim's misfit in proportion to the error of the real images over that of its own.

    An encoder with errors in the images has errors in the state, and they are smooth along the motion.
    """
    if seen is None or not seen.suspect:
        return sim
    return replace(sim, misfit=max(sim.misfit, 1.0) * max(seen.ratio, 1.0))


def _adapt_settings(inputs: DiagnosisInputs, config: DiagnoseConfig) -> DiagnoseConfig:
    """Adapt the settings to the sim: its priors, correlation and inputs, and effects that are ruled out."""
    hold = inputs.hold or config.input_hold
    config = replace(
        config,
        effective_sample_ratio=max(config.effective_sample_ratio, inputs.sim.correlation),
        input_hold=hold,
    )
    if inputs.same_recording:
        config = replace(config, without=[*config.without, *list_absorbed_effects()])
    if inputs.recordings is None:
        return config
    return replace(
        config,
        without=[*config.without, *inputs.recordings.ruled_out],
        **{
            name: min(config.learned_factor * getattr(config, name), 0.5)
            for name in ("potential", "damping", "inputs", "offset", "warp")
        },
    )


def locate_with_verdict(where: ResidualLocation, found: DiagnosisRun) -> ResidualLocation:
    """Combine verdict and residual: named components get its probability, the residual shares the rest."""
    chosen = [effect.effect for effect in found.chosen.effects]
    probability = found.diagnosis.candidates[0].probability
    named = [effect.component for effect in chosen if effect.component is not None]
    shares = {name: (1.0 - probability if named else 1.0) * share for name, share in where.components.items()}
    for name in named:
        shares[name] = shares.get(name, 0.0) + probability / len(named)
    return replace(where, level=chosen[0].level, components=shares)


def list_absorbed_effects() -> tuple[str, ...]:
    """Effects that a sim fitted to the same recording has already absorbed in its parameters."""
    return tuple(effect.name for effect in list_effects() if effect.absorbed_by_fit)


def flag_extrapolation(found: Diagnosis, checked: DataCheck) -> Diagnosis:
    """Mark a verdict `unknown` as undetermined where the sim is extrapolated or misses its own recordings."""
    why = [finding.text for finding in checked.findings if finding.check in (MOSTLY_OUTSIDE_CHECK, LAWLESS)]
    if found.verdict != "unknown" or not why:
        return found
    return replace(found, checks={**found.checks, "undetermined": why})


def withhold_verdict(found: Diagnosis) -> Diagnosis:
    """Withhold the verdict: no name exceeds `VERDICT.max_withheld_probability`, the rest is spread evenly."""
    top, even = found.candidates[0].probability, 1.0 / len(found.candidates)
    most = VERDICT.max_withheld_probability
    share = 1.0 if top <= most else max(most - even, 0.0) / (top - even)
    spread = (1.0 - share) * even
    flat = tuple(replace(c, probability=share * c.probability + spread) for c in found.candidates)
    return replace(found, verdict="undetermined", candidates=flat, combination=())


def diagnose_files(sim: str, real: str, out: Path, config: DiagnoseConfig, *, command: str) -> Diagnosis:
    """Write ``diagnosis.json``, ``rollouts.csv``, ``augmented.safetensors`` and ``report.html``.

    Raises:
        OSError: ``out`` cannot be written to.
        FileNotFoundError, ValueError: as `open_diagnosis_inputs`; nothing is written then, and an older
            ``diagnosis.json`` in ``out`` is gone.
    """
    require_writable(out)
    (out / "diagnosis.json").unlink(missing_ok=True)  # an older one must not pass for this one
    with warnings.catch_warnings(record=True) as caught, np.errstate(all="ignore"):
        # rollouts of a wrong hypothesis overflow; what is not finite is rejected where it is compared
        warnings.simplefilter("always")
        inputs, found, content = _diagnose_arguments(sim, real, config)
    found = replace(found, diagnosis=_add_warnings(found.diagnosis, caught))
    diagnosis = found.diagnosis
    out.mkdir(parents=True, exist_ok=True)
    settings: dict[str, Any] = {"sim": sim, "real": real, "config": asdict(config), "stamp": stamp()}
    added = build_augmented_simulator(inputs, found)
    save_augmented(out / AUGMENTED_FILE, added, settings)
    diagnosis = write_mujoco_patch(sim, out / "patched.xml", added, diagnosis, config)
    # written even without blocks, so that no older file passes for this one's
    save_rollouts(out / "rollouts.csv", diagnosis.blocks, q_names=diagnosis.q_names)
    save_report(out / "report.html", diagnosis, replace(content, command=command, stamp=stamp()))
    save_diagnosis(out / "diagnosis.json", diagnosis)
    return diagnosis


def _diagnose_arguments(
    sim: str, real: str, config: DiagnoseConfig
) -> tuple[DiagnosisInputs, DiagnosisRun, ReportContent]:
    inputs = open_diagnosis_inputs(sim, real, config)
    with tqdm(unit="effect", leave=False) as bar:

        def report_progress(name: str) -> None:
            bar.set_description(name)
            bar.update()

        try:
            found = run_diagnosis(inputs, config, report_progress=report_progress)
        except ValueError as error:
            raise ValueError(_explain_failure(inputs.checked, error)) from error
        report_progress("figures")
        figures = build_report_content(inputs, found)
        if inputs.recordings is None:
            return inputs, found, figures
        from lagsplat.pipelines.diagnosis_images import build_image_content

        report_progress("pictures")
        found, seen = build_image_content(inputs, found)
        return (
            inputs,
            found,
            replace(figures, image_error=seen.image_error, image_force=seen.image_force, video=seen.video),
        )


def _explain_failure(checked: DataCheck, error: ValueError) -> str:
    """Say why nothing could be fitted, after the findings on the data."""
    text = str(error)
    if isinstance(error, np.linalg.LinAlgError) or "infs or NaNs" in text:
        text = "The sim cannot follow the real motions, its numbers overflow; check units and signs"
    return " ".join([*checked.warnings, text])


def _add_warnings(diagnosis: Diagnosis, caught: Sequence[warnings.WarningMessage]) -> Diagnosis:
    """Add the user warnings that were raised on the way; those for programmers are dropped."""
    texts = [str(caught_one.message) for caught_one in caught if caught_one.category is UserWarning]
    new = [text for text in dict.fromkeys(texts) if text not in diagnosis.warnings]
    return replace(diagnosis, warnings=(*diagnosis.warnings, *new))


def require_writable(out: Path) -> None:
    """Check that results can be written to ``out``, before minutes are spent on them.

    Raises:
        OSError: ``out`` is a file, lies below one, or cannot be written to.
    """
    if out.exists() and not out.is_dir():
        raise NotADirectoryError(f"out={out} is a file; name a folder")
    place = next(place for place in (out, *out.absolute().parents) if place.exists())
    if not place.is_dir():
        raise NotADirectoryError(f"out={out}: {place} is a file; name another folder")
    if not os.access(place, os.W_OK):
        raise PermissionError(f"out={out}: {place} cannot be written to; name another folder")


def write_mujoco_patch(
    sim: str, out: Path, added: AugmentedSimulator, diagnosis: Diagnosis, config: DiagnoseConfig
) -> Diagnosis:
    """Write a MuJoCo sim's file with the effects that MuJoCo can express; ``checks`` lists them."""
    if Path(sim).suffix.lower() not in (".xml", ".mjcf") or not added.effects:
        return diagnosis
    from lagsplat.diagnose.augmented.mujoco_export import patch_augmented

    changes = patch_augmented(Path(sim), out, added, joints=config.joints, actuators=config.actuators)
    lines = list(changes) or ["MuJoCo has no counterpart of what was found; the file was left as it is"]
    return replace(diagnosis, checks={**diagnosis.checks, "mujoco": lines})


def build_augmented_simulator(inputs: DiagnosisInputs, found: DiagnosisRun) -> AugmentedSimulator:
    """The sim with the chosen effects, or with its refitted parameters alone."""
    rollout_model, chosen = found.problem.rollout_model, found.chosen
    effects = [effect for effect in chosen.effects if not isinstance(effect.effect, SampleEffect)]
    return build_augmented(
        rollout_model,
        effects,
        chosen.fit.x,
        q_names=inputs.real[0].q_names,
        u_names=inputs.real[0].u_names,
        region=sample_operating_region(rollout_model.dataset),
    )


def build_report_content(inputs: "DiagnosisInputs", found: DiagnosisRun) -> ReportContent:
    """Content of the report beside the verdict: error budget, correlations, separability and profiles."""
    noise_inflation, real = found.ranking.noise_inflation, inputs.real[0]
    where = found.diagnosis.where
    return ReportContent(
        stages=compute_error_stages(inputs, found),
        correlations=where
        and compute_residual_correlations(where.smoothed, q_names=real.q_names, u_names=real.u_names),
        separability=compute_separability(
            found.problem, found.ranking.found, noise_inflation=noise_inflation
        ),
        profiles=tuple(compute_profiles(found.problem, found.chosen, noise_inflation=noise_inflation)),
    )


def compute_error_stages(inputs: "DiagnosisInputs", found: DiagnosisRun) -> tuple[ErrorStage, ...]:
    """The error budget; its floors are the errors on the sim's own trajectories.

    Empty where the residual could not be estimated.
    """
    if found.diagnosis.where is None:
        return ()
    checked, period_s = inputs.checked.sim, float(found.diagnosis.checks["natural_period_s"])
    nominal = None
    if checked is not None:
        part = _first_part(checked.motions, MAX_NOMINAL_PERIODS * period_s)
        hold = "zoh" if found.problem.rollout_model.held else "linear"
        with contextlib.suppress(np.linalg.LinAlgError):  # the sim diverges even on its own trajectories
            nominal = estimate_latent_force(inputs.sim.model, part, period_s=period_s, hold=hold)
    image_quality = None if inputs.recordings is None else inputs.recordings.image_quality
    return measure_error_stages(
        inputs.sim.model,
        found.diagnosis.where.smoothed,
        nominal,
        horizon_s=period_s,
        image_errors=None
        if image_quality is None
        else (image_quality.error_real, image_quality.error_nominal),
        block=10,
    )


def _first_part(motions: Sequence[Trajectory], length_s: float) -> list[Trajectory]:
    """The first trajectories that last ``length_s`` together."""
    kept: list[Trajectory] = []
    for motion in motions:
        if length_s > 0.0:
            kept.append(leading_samples(motion, length_s))
            length_s -= kept[-1].duration_s
    return kept
