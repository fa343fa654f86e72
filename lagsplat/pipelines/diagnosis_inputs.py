"""The inputs of a diagnosis: a simulator of any kind and real trajectories, read and checked."""

import contextlib
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lagsplat.diagnose.core.config import CALIBRATION_CHECKS, ESTIMATED_SIMULATOR, DiagnoseConfig
from lagsplat.diagnose.core.result import Finding
from lagsplat.diagnose.data_quality.checks import DataCheck, check_data
from lagsplat.diagnose.data_quality.natural_period import estimate_spectral_period_s
from lagsplat.diagnose.data_quality.sampling import REPEATED_SAMPLES_CHECK, average_dense_samples
from lagsplat.diagnose.effects.excitation import Excitation, assess_excitation
from lagsplat.diagnose.estimation.dataset import prepare_dataset, sample_operating_region
from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator, estimate_simulator
from lagsplat.diagnose.inference.problem import calibrate_misfit
from lagsplat.diagnose.inference.recalibration import recalibrate_simulator
from lagsplat.diagnose.simulators.sources import DataSource, find_sources, read_sources
from lagsplat.io.trajectory.trajectory import Trajectory
from lagsplat.pipelines.apply_diagnosis import sample_simulator

if TYPE_CHECKING:
    from lagsplat.pipelines.diagnosis_videos import RecordingPair

MODELS = ("run", "model", "mujoco", "python")
LAWLESS = "a law that is true nowhere"  # name of the finding that a run's law misses its own recordings


@dataclass(frozen=True)
class DiagnosisInputs:
    """A simulator and the real trajectories it is compared with, checked."""

    sim: EstimatedSimulator
    checked: DataCheck
    excitation: tuple[Excitation, ...]
    same_recording: bool  # whether the sim was fitted to the very recording that is diagnosed
    recordings: "RecordingPair | None" = None
    """The recordings with their images, where the sim is a fitted run."""
    hold: str | None = None  # inputs between samples, where the sim's own recordings contradict the settings

    @property
    def real(self) -> tuple[Trajectory, ...]:
        """The real trajectories, cut where they are not continued."""
        return self.checked.real.motions

    @property
    def null_motion(self) -> Trajectory | None:
        """A trajectory without any effect that the sim still misses, as every fitted run does; or None."""
        if self.recordings is not None:
            return self.recordings.null_motion
        if self.checked.sim is None or self.sim.misfit < CALIBRATION_CHECKS.missed_misfit:
            return None
        return max(self.checked.sim.motions, key=lambda motion: motion.duration_s)


def open_diagnosis_inputs(sim: str, real: str, config: DiagnoseConfig) -> DiagnosisInputs:
    """Read and check what the arguments name, and make the simulator's model.

    Args:
        sim: recordings, a program, a MuJoCo file, an augmented sim, or the folder of a fitted run.
        real: recordings of the real mechanism; ``held_out`` is a fitted run's own held-out part.
        config: settings of the diagnosis.

    Raises:
        FileNotFoundError: a file does not exist.
        ValueError: a file cannot be read, or sim and real have different coordinates or inputs.
    """
    sims = find_sources(sim)
    models = [source for source in sims if source.kind in MODELS]
    if models and len(sims) > 1:
        raise ValueError(f"sim={sim}: name one model, or recordings; {models[0].path} is a {models[0].kind}")
    nominal: tuple[Trajectory, ...] = ()
    same_recording, recordings = False, None
    if models and models[0].kind == "run":
        from lagsplat.pipelines.diagnosis_videos import (
            open_recording_pair,  # torch, which the other sims do without
        )

        recordings = open_recording_pair(
            Path(models[0].path), real, columns=config.columns, longest_s=config.reference_longest_s
        )
        nominal, motions, same_recording = recordings.nominal, recordings.real, recordings.same_recording
    else:
        motions = read_sources(find_sources(real), columns=config.columns)
        if not models:
            nominal = read_sources(sims, columns=config.columns)
    checked = check_data(nominal, motions)
    if recordings is not None:
        checked = replace(checked, findings=(*recordings.findings, *checked.findings))
    else:  # samples of a video belong to its frames, so they are kept
        checked = _decimate(checked, hold=config.input_hold)
    excitation: tuple[Excitation, ...] = ()
    period_s = checked.real.period_s or (checked.sim.period_s if checked.sim else None)
    if period_s is not None:
        excitation = assess_excitation(
            checked.real.motions,
            period_s=period_s,
            noise=checked.real.noise,
            closed_loop=checked.closed_loop,
        )
    simulator = _open_simulator(
        models, checked, config, recordings.null_motion if recordings is not None else None
    )
    hold = None
    if not models and config.input_hold == "linear":
        with_hold = _try_held_inputs(checked, config, simulator)
        if with_hold is not None:
            simulator, hold = with_hold, "zoh"
            checked = replace(checked, findings=(*checked.findings, _held_inputs_finding(sim)))
    findings = _simulator_findings(simulator, sim, () if models else nominal)
    checked = replace(checked, findings=(*checked.findings, *findings))
    return DiagnosisInputs(simulator, checked, excitation, same_recording, recordings, hold)


def _simulator_findings(known: EstimatedSimulator, sim: str, nominal: Sequence[Trajectory]) -> list[Finding]:
    """Findings on the simulator; ``nominal`` are recordings it was estimated from, empty if given."""
    findings = []
    if known.misfit > ESTIMATED_SIMULATOR.diverged_misfit:
        lost = _lost_recordings_finding(known, nominal) if nominal else _lost_model_finding(known, sim)
        findings.append(lost)
    if known.original is not None:
        findings.append(_recalibrated_finding(known, sim))
    if known.outlier_spans:
        findings.append(_disturbed_finding(known))
    return findings


def _decimate(checked: DataCheck, *, hold: str) -> DataCheck:
    """Average samples that are denser than the motion needs; findings of repeats in them no longer hold."""
    real, notes = average_dense_samples(checked.real.motions, hold=hold)
    checked = replace(checked, real=replace(checked.real, motions=real))
    if checked.sim is not None:
        nominal, nominal_notes = average_dense_samples(checked.sim.motions, hold=hold)
        checked, notes = replace(checked, sim=replace(checked.sim, motions=nominal)), (*notes, *nominal_notes)
    averaged = {finding.source for finding in notes}
    kept = [
        finding
        for finding in checked.findings
        if finding.check != REPEATED_SAMPLES_CHECK or finding.source not in averaged
    ]
    return replace(checked, findings=(*kept, *notes))


def _try_held_inputs(
    checked: DataCheck, config: DiagnoseConfig, known: EstimatedSimulator
) -> EstimatedSimulator | None:
    """Estimate the sim with a zero-order hold of the inputs; None unless they step and the fit is better.

    Half a sample is little, but a law that compensates for it needs more terms and extrapolates badly.
    """
    assert checked.sim is not None
    change = np.concatenate([np.diff(m.u, axis=0) for m in checked.sim.motions])
    if (
        not change.any()
        or np.mean(change[:, change.any(axis=0)] == 0.0) < CALIBRATION_CHECKS.min_repeated_share
    ):
        return None
    with_hold = estimate_simulator(checked.sim.motions, replace(config, input_hold="zoh"))
    same_windows = (
        with_hold.window_scale == known.window_scale and with_hold.outlier_spans == known.outlier_spans
    )
    better = (
        with_hold.bic < known.bic - CALIBRATION_CHECKS.min_criterion_gain
        if same_windows
        else with_hold.misfit < CALIBRATION_CHECKS.max_misfit_share * known.misfit
    )
    return with_hold if better else None


def _held_inputs_finding(source: str) -> Finding:
    return Finding(
        "note",
        "held inputs",
        source,
        "the inputs step, and the sim's recordings fit better, or with a simpler law, if each value is held "
        "until the next; so it was done for the sim and for the real recordings",
        "a step that is interpolated linearly between two samples acts half a sample early",
        "set diagnose.input_hold=zoh to hold inputs in any case",
    )


def _recalibrated_finding(sim: EstimatedSimulator, source: str) -> Finding:
    assert sim.original is not None
    given, left = (np.sqrt(max(simulator.misfit, 0.0)) for simulator in (sim.original, sim))
    return Finding(
        "warn",
        "law of the run",
        source,
        f"the law misses its own recordings by {given:.2g} times their noise within two periods; it was "
        f"recalibrated before the comparison and now misses them by {left:.2g}",
        "the errors of the law are then not taken for an effect: they count as part of what a refit closes",
        "fit the run longer if that part is large",
    )


def _disturbed_finding(sim: EstimatedSimulator) -> Finding:
    spans_by_file: dict[str, list[str]] = {}
    for span in sim.outlier_spans:
        spans_by_file.setdefault(span.file, []).append(f"{span.start_s:.4g} to {span.stop_s:.4g} s")
    spans = ", ".join(f"{file} from {' and '.join(times)}" for file, times in spans_by_file.items())
    return Finding(
        "warn",
        "disturbed sim",
        "sim",
        f"no law fits {spans} together with the rest; the sim was estimated without these outliers",
        "something acted there that no column records, as a push by hand, or the mechanism was different",
        "look at what happened there, and cut it out",
    )


def _lost_model_finding(sim: EstimatedSimulator, source: str) -> Finding:
    return Finding(
        "warn",
        LAWLESS,
        source,
        f"the law misses its own recordings by {np.sqrt(sim.misfit):.0f} times their noise within two "
        "periods, and no change of its potential, damping and input map corrected that",
        "errors of the law cannot be separated from what the real mechanism adds",
        "fit the run longer, or look at its rollouts first",
    )


def _lost_recordings_finding(sim: EstimatedSimulator, nominal: Sequence[Trajectory]) -> Finding:
    return Finding(
        "undetermined",
        "law of the sim",
        "sim",
        f"the law estimated from {', '.join(m.source for m in nominal)} misses these recordings themselves "
        f"by {np.sqrt(sim.misfit):.0f} times their noise within two periods",
        "something acted there that no column records, as a push by hand, or the law is not smooth; errors "
        "of the sim cannot be separated from what the real mechanism adds",
        "cut the recordings to parts in which only the logged inputs act, or give the sim as a program",
    )


def _open_simulator(
    models: Sequence[DataSource], checked: DataCheck, config: DiagnoseConfig, null_motion: Trajectory | None
) -> EstimatedSimulator:
    if not models:
        assert checked.sim is not None
        return estimate_simulator(checked.sim.motions, config)
    # the projection must hold on the sim's own recordings as well: its misfit is measured there
    seen = (*checked.real.motions, *(checked.sim.motions if checked.sim is not None else ()))
    ready = prepare_dataset(seen, period_s=estimate_spectral_period_s(checked.real.motions))
    sampled = sample_simulator(
        models[0].path,
        sample_operating_region(ready.dataset),
        joints=config.joints,
        actuators=config.actuators,
    )
    projected = EstimatedSimulator.exact(sampled.model)
    if checked.sim is None:
        return projected
    nominal = checked.sim.motions
    calibrated = _calibrate(projected, null_motion, nominal, config)
    if calibrated.misfit < CALIBRATION_CHECKS.missed_misfit:
        return calibrated
    recalibrated = recalibrate_simulator(calibrated, nominal, config)
    return (
        calibrated if recalibrated is calibrated else _calibrate(recalibrated, null_motion, nominal, config)
    )


def _calibrate(
    sim: EstimatedSimulator,
    null_motion: Trajectory | None,
    nominal: Sequence[Trajectory],
    config: DiagnoseConfig,
) -> EstimatedSimulator:
    """Measure the sim's misfit on a reference that no fit used, or on all recordings if it is too short."""
    if null_motion is not None:
        with contextlib.suppress(ValueError):
            return calibrate_misfit(sim, [null_motion], config)
    return calibrate_misfit(sim, nominal, config)
