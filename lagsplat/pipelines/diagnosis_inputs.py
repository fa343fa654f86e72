"""The inputs of a diagnosis: a simulator of any kind and real trajectories, read and checked."""

import contextlib
import re
import warnings
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from lagsplat.diagnose.core.config import IDENTIFICATION, RECALIBRATION, DiagnoseConfig
from lagsplat.diagnose.core.result import Finding
from lagsplat.diagnose.data_quality.checks import DataCheck, check_data
from lagsplat.diagnose.data_quality.natural_period import (
    estimate_natural_period_s,
    estimate_spectral_period_s,
)
from lagsplat.diagnose.data_quality.noise import measure_noise
from lagsplat.diagnose.data_quality.sampling import REPEATED_SAMPLES_CHECK, average_dense_samples
from lagsplat.diagnose.effects.registry import list_effects
from lagsplat.diagnose.estimation.dataset import prepare_dataset, sample_operating_region
from lagsplat.diagnose.identification.estimated_simulator import EstimatedSimulator, estimate_simulator
from lagsplat.diagnose.inference.recalibration import calibrate_misfit, recalibrate_simulator
from lagsplat.diagnose.simulators.joint_models import JointModel, build_joint_models, find_motors
from lagsplat.diagnose.simulators.mujoco_model import check_urdf
from lagsplat.io.mujoco.model import find_position_targets, load_mujoco
from lagsplat.io.sources import (
    VIDEO_KINDS,
    DataSource,
    adopt_names,
    find_sources,
    prefer_numbers,
    read_sources,
)
from lagsplat.io.trajectory.trajectory import Trajectory
from lagsplat.pipelines.apply_diagnosis import MODELS, sample_simulator

if TYPE_CHECKING:
    from lagsplat.pipelines.diagnosis_videos import RecordingPair

TARGET_NAME = (
    r"(?:(?:target|desired|des|goal|ref|reference|setpoint|cmd|command)[_. ]?{0}"
    r"|{0}[_. ]?(?:target|desired|des|goal|ref|reference|setpoint|cmd|command))"
)
"""How a log calls the target of a coordinate, as a pattern of the coordinate's own name."""


@dataclass(frozen=True)
class DiagnosisInputs:
    """A simulator and the real trajectories it is compared with, checked."""

    sim: EstimatedSimulator
    checked: DataCheck
    recordings: "RecordingPair | None" = None
    """The recordings with their images, where the sim is a fitted run."""
    targets: Mapping[str, str] = field(default_factory=dict)
    """Inputs that are position targets, each with its coordinate, by the settings, names or a MuJoCo file."""
    hold: str | None = None  # inputs between samples, where the sim's own recordings contradict the settings
    joint: JointModel | None = None  # the joint, where it is diagnosed by itself

    @property
    def real(self) -> tuple[Trajectory, ...]:
        """The real trajectories, cut where they are not continued."""
        return self.checked.real.motions

    @property
    def absorbed(self) -> tuple[str, ...]:
        """Effects that a sim fitted to the very recording that is diagnosed has in its parameters already."""
        if self.recordings is None or not self.recordings.same_recording:
            return ()
        return tuple(effect.name for effect in list_effects() if effect.kind == "parameter")

    @property
    def tolerances_are_causes(self) -> bool:
        """Whether a parameter that is off within its tolerance is a cause.

        It is none where the sim was learned, or misses runs of its own file by more than their noise.
        """
        return self.recordings is None and not (self.joint is not None and self._misses_itself)

    @property
    def _misses_itself(self) -> bool:
        """Whether the sim misses its own recordings by more than their noise."""
        return self.sim.misfit >= RECALIBRATION.missed_misfit

    @property
    def reference(self) -> Trajectory | None:
        """A trajectory without any effect, on which the sim's own error is measured; or None."""
        if self.joint is not None and self._misses_itself:
            return max(self.joint.nominal, key=lambda motion: motion.duration_s)
        return self.null_motion

    @property
    def null_motion(self) -> Trajectory | None:
        """A trajectory without any effect that the sim still misses, as every fitted run does; or None."""
        if self.recordings is not None:
            return self.recordings.null_motion
        if self.checked.sim is None or not self._misses_itself:
            return None
        return max(self.checked.sim.motions, key=lambda motion: motion.duration_s)


def open_diagnosis_inputs(
    sim: str,
    real: str,
    config: DiagnoseConfig,
    *,
    show_checks: Callable[[DataCheck], None] = lambda _: None,
    show_fit: Callable[[str], None] = lambda _: None,
) -> DiagnosisInputs:
    """Read and check what the arguments name, and make the simulator's model.

    ``sim`` names recordings, a program, a MuJoCo file, an augmented sim, the folder of a fitted run, or a
    film that a run is fitted to; ``real`` names recordings of the real mechanism, or the run's own by
    ``held_out``. ``show_fit`` is called with a sentence on the run before one is fitted to a film, and
    ``show_checks`` with the checks of the data before anything else is fitted.

    Raises:
        FileNotFoundError: a file does not exist.
        ValueError: a file cannot be read, or sim and real have different coordinates or inputs.
    """
    return _open_coupled(_read_sides(sim, real, config, show_checks, show_fit), config)


def open_inputs_by_joint(
    sim: str,
    real: str,
    config: DiagnoseConfig,
    *,
    show_checks: Callable[[DataCheck], None] = lambda _: None,
    show_fit: Callable[[str], None] = lambda _: None,
) -> tuple[DiagnosisInputs, ...]:
    """As `open_diagnosis_inputs`; one for each joint of a MuJoCo chain of more than `max_coupled` of them.

    A joint that never moves is left out. Where a joint has no motor of its own whose torque is logged, all
    joints are one, with a warning.

    Raises:
        FileNotFoundError, ValueError: as `open_diagnosis_inputs`.
    """
    sides = _read_sides(sim, real, config, show_checks, show_fit)
    return _open_joints(sides, config) or (_open_coupled(sides, config),)


@dataclass(frozen=True)
class _Sides:
    """Both sides as they were read: the sim's sources, its recordings, and the checks."""

    sim: str
    models: Sequence[DataSource]
    nominal: Sequence[Trajectory]
    recordings: "RecordingPair | None"
    checked: DataCheck


def _read_sides(
    sim: str,
    real: str,
    config: DiagnoseConfig,
    show_checks: Callable[[DataCheck], None],
    show_fit: Callable[[str], None],
) -> _Sides:
    sims = prefer_numbers(find_sources(sim), config.columns)
    of_film: tuple[Finding, ...] = ()
    if any(source.kind in VIDEO_KINDS for source in sims):
        from lagsplat.pipelines import film_runs  # torch, which the other sims do without

        folder, of_film = film_runs.fit_film(sims, real, config, show_fit=show_fit)
        sims = (DataSource("run", str(folder)),)
    models = [source for source in sims if source.kind in MODELS]
    if models and len(sims) > 1:
        raise ValueError(f"sim={sim}: name one model, or recordings; {models[0].path} is a {models[0].kind}")
    nominal: Sequence[Trajectory] = ()
    recordings = None
    if models and models[0].kind == "run":
        from lagsplat.pipelines import diagnosis_videos  # torch, likewise

        recordings = diagnosis_videos.open_recording_pair(
            Path(models[0].path), real, columns=config.columns, longest_s=config.reference_longest_s
        )
        checked = check_data(recordings.nominal, recordings.real)
        of_videos = [finding for each in recordings.real_recordings for finding in each.findings]
        checked = replace(checked, findings=(*of_film, *of_videos, *checked.findings))
    else:  # samples of a video belong to its frames, so they are kept
        columns, joint_unit = config.columns, config.joint_unit
        motions = read_sources(find_sources(real), columns=columns, joint_unit=joint_unit)
        if not models:
            nominal = read_sources(sims, columns=columns, joint_unit=joint_unit)
            motions = adopt_names(motions, nominal)
        checked = _decimate(
            check_data(nominal, motions), hold=config.input_hold, chain=_is_chain(models, motions, config)
        )
        if models and models[0].kind == "mujoco":
            checked = replace(checked, findings=(*check_urdf(Path(models[0].path)), *checked.findings))
    show_checks(checked)
    return _Sides(sim, models, nominal, recordings, checked)


def _open_coupled(sides: _Sides, config: DiagnoseConfig) -> DiagnosisInputs:
    """One simulator of all coordinates."""
    models, checked, recordings = sides.models, sides.checked, sides.recordings
    null_motion = None if recordings is None else recordings.null_motion
    simulator, hold = _open_simulator(models, checked, config, null_motion)
    findings = _simulator_findings(simulator, sides.sim, sides.nominal, held=hold is not None)
    checked = replace(checked, findings=(*checked.findings, *findings))
    targets = _find_targets(models, checked.real.motions[0], config)
    return DiagnosisInputs(simulator, checked, recordings, targets, hold)


def _open_joints(sides: _Sides, config: DiagnoseConfig) -> tuple[DiagnosisInputs, ...]:
    """One simulator for each joint; nothing where the sim is no such chain."""
    motions = sides.checked.real.motions
    if not _is_chain(sides.models, motions, config):
        return ()
    path = Path(sides.models[0].path)
    chosen = load_mujoco(path, **config.model_choice)
    if (len(chosen.joints), len(chosen.actuators)) != (motions[0].d, motions[0].n_u):
        return ()  # refused with both numbers where all are opened as one
    targets = _find_targets(sides.models, motions[0], config)
    motors = find_motors(chosen, np.concatenate([motion.q for motion in motions]))
    lacking = [name for i, name in enumerate(chosen.joints) if i not in motors]
    if targets or lacking or chosen.followers:
        why = f"{', '.join(targets)} is a position target and no torque"
        if lacking:
            why = f"no motor with a logged torque drives {', '.join(lacking)} alone"
        if chosen.followers:
            why = "other joints follow them by an equality"
        warnings.warn(
            f"{path.name}: its {motions[0].d} joints are diagnosed as one, which takes long, because {why}; "
            "log the torque of each joint, or name fewer joints with diagnose.joints=[...]",
            stacklevel=4,
        )
        return ()
    made = build_joint_models(path, chosen, motors, motions, hold=config.input_hold)
    return tuple(_open_joint(joint, sides.checked, config) for joint in made)


def _open_joint(joint: JointModel, checked: DataCheck, config: DiagnoseConfig) -> DiagnosisInputs:
    """The inputs of one joint, its sim's misfit measured on a run of the file that moves alike."""
    period_s = estimate_natural_period_s(joint.motions) or estimate_spectral_period_s(joint.motions)
    noise = measure_noise(joint.motions, period_s=period_s)
    logged = [replace(each, u=each.u[:, :1], u_names=each.u_names[:1], computed=()) for each in joint.motions]
    side = replace(checked.real, motions=tuple(logged), period_s=period_s, noise=noise)
    sim = calibrate_misfit(joint.sim, joint.nominal, config)
    checked = replace(checked, real=replace(side, motions=joint.motions))
    return DiagnosisInputs(sim, checked, joint=joint)


def list_unseen(*, film: bool) -> tuple[str, ...]:
    """Effects that a film, or a log, cannot show."""
    other = "log" if film else "film"
    return tuple(effect.name for effect in list_effects() if effect.recorded_by == other)


def _find_targets(
    models: Sequence[DataSource], motion: Trajectory, config: DiagnoseConfig
) -> Mapping[str, str]:
    """The inputs that are position targets, each with its coordinate.

    They are those of the settings, inputs that the file calls the target of a coordinate (``elbow_target``
    beside ``elbow``), and position actuators of a MuJoCo file.
    """
    found: dict[str, str] = {}
    if models and models[0].kind == "mujoco":
        chosen = load_mujoco(Path(models[0].path), **config.model_choice)
        found |= {motion.u_names[j]: motion.q_names[i] for j, i in find_position_targets(chosen)}
    of_run = bool(models) and models[0].kind == "run"  # which names them, whatever the columns of a table
    columns = {} if of_run else config.columns
    own = {name: columns.get(name, name).lower() for name in (*motion.q_names, *motion.u_names)}
    for q_name in motion.q_names:
        aimed = re.compile(TARGET_NAME.format(re.escape(own[q_name])))
        # an action of a LeRobot dataset has the name of the state that it is the target of
        named = (
            u_name for u_name in motion.u_names if own[u_name] == own[q_name] or aimed.fullmatch(own[u_name])
        )
        found |= dict.fromkeys(named, q_name)
    return {**found, **config.targets}


def _is_chain(models: Sequence[DataSource], motions: Sequence[Trajectory], config: DiagnoseConfig) -> bool:
    """Whether a sim may be diagnosed joint by joint."""
    return bool(models) and models[0].kind == "mujoco" and motions[0].d > config.max_coupled


def _decimate(checked: DataCheck, *, hold: str, chain: bool) -> DataCheck:
    """Average samples that are denser than the motion needs; findings of repeats in them no longer hold.

    Fewer are averaged where samples repeat those before, which a mean hides, and in a ``chain``, where the
    accelerations of joints are inputs of others.
    """
    fine = {finding.source for finding in checked.findings if finding.check == REPEATED_SAMPLES_CHECK}
    if chain:
        fine = {motion.source for motion in checked.real.motions}
    real, notes = average_dense_samples(checked.real.motions, hold=hold, kept_fine=fine)
    checked = replace(checked, real=replace(checked.real, motions=real))
    if checked.sim is not None:
        nominal, nominal_notes = average_dense_samples(checked.sim.motions, hold=hold, kept_fine=fine)
        checked, notes = replace(checked, sim=replace(checked.sim, motions=nominal)), (*notes, *nominal_notes)
    averaged = {finding.source for finding in notes}
    kept = [
        finding
        for finding in checked.findings
        if finding.check != REPEATED_SAMPLES_CHECK or finding.source not in averaged
    ]
    return replace(checked, findings=(*kept, *notes))


def _open_simulator(
    models: Sequence[DataSource], checked: DataCheck, config: DiagnoseConfig, null_motion: Trajectory | None
) -> tuple[EstimatedSimulator, str | None]:
    """The simulator, given or estimated, and the hold of its inputs where that is not the one set."""
    nominal = () if checked.sim is None else checked.sim.motions
    if not models:
        known = estimate_simulator(nominal, config)
        with_hold = _try_held_inputs(nominal, config, known) if config.input_hold == "linear" else None
        return (known, None) if with_hold is None else (with_hold, "zoh")
    # the projection must hold on the sim's own recordings as well: its misfit is measured there
    period_s = estimate_spectral_period_s(checked.real.motions)
    ready = prepare_dataset((*checked.real.motions, *nominal), period_s=period_s)
    region = sample_operating_region(ready.dataset)
    sampled = sample_simulator(models[0].path, region, **config.model_choice)
    given = replace(EstimatedSimulator.exact(sampled.model), known_region=sampled.known_region)
    if not nominal:
        return given, None
    given = _calibrate(given, null_motion, nominal, config)
    if given.misfit < RECALIBRATION.missed_misfit:
        return given, None
    recalibrated = recalibrate_simulator(given, nominal, config)
    if recalibrated is not given:
        given = _calibrate(recalibrated, null_motion, nominal, config)
    return given, None


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


def _try_held_inputs(
    nominal: Sequence[Trajectory], config: DiagnoseConfig, known: EstimatedSimulator
) -> EstimatedSimulator | None:
    """Estimate the sim with a zero-order hold of the inputs; None unless they step and the fit is better.

    Half a sample is little, but a law that compensates for it needs more terms and extrapolates badly.
    """
    change = np.concatenate([np.diff(motion.u, axis=0) for motion in nominal])
    moving = change[:, change.any(axis=0)]
    if not moving.size or np.mean(moving == 0.0) < IDENTIFICATION.min_repeated_share:
        return None
    with_hold = estimate_simulator(nominal, replace(config, input_hold="zoh"))
    same_data = (
        with_hold.window_scale == known.window_scale and with_hold.outlier_spans == known.outlier_spans
    )
    if same_data and with_hold.criterion and known.criterion:
        better = with_hold.criterion.exceed(known.criterion) < -IDENTIFICATION.min_hold_gain
    else:
        better = with_hold.misfit < IDENTIFICATION.max_hold_misfit_share * known.misfit
    return with_hold if better else None


def _simulator_findings(
    sim: EstimatedSimulator, source: str, nominal: Sequence[Trajectory], *, held: bool
) -> list[Finding]:
    """Findings on the simulator; ``nominal`` are recordings it was estimated from, empty if given."""
    findings = []
    unrecorded = "something acted there that no column records, as a push by hand"
    if held:
        what = (
            "the inputs step, and the sim's recordings fit better, or with a simpler law, if each value is "
            "held until the next; so it was done for the sim and for the real recordings"
        )
        why = "a step that is interpolated linearly between two samples acts half a sample early"
        remedy = "set diagnose.input_hold=zoh to hold inputs in any case"
        findings.append(Finding("note", "held inputs", source, what, why, remedy))
    if sim.misfit > IDENTIFICATION.diverged_misfit:
        size = f"{np.sqrt(sim.misfit):.0f} times their noise within two periods"
        if nominal:
            files = ", ".join(motion.source for motion in nominal)
            what = f"the law estimated from {files} misses these recordings themselves by {size}"
            why = (
                f"{unrecorded}, or the law is not smooth; its errors cannot be separated from what the real "
                "mechanism adds"
            )
            remedy = "keep parts in which the logged inputs act alone, or give the sim as a program"
            findings.append(Finding("undetermined", "law of the sim", "sim", what, why, remedy))
        else:
            what = (
                f"the law misses its own recordings by {size}, and no change of its potential, damping and "
                "input map corrected that"
            )
            remedy = "fit the run longer, or look at its rollouts first"
            why = "its errors count as noise, so that only a gap beyond them is found"
            findings.append(Finding("warn", "law of the run", source, what, why, remedy))
    if sim.original is not None:
        given, left = (np.sqrt(max(each.misfit, 0.0)) for each in (sim.original, sim))
        what = (
            f"the law misses its own recordings by {given:.2g} times their noise within two periods; it was "
            f"recalibrated before the comparison and now misses them by {left:.2g}"
        )
        why = (
            "the errors of the law are then not taken for an effect: "
            "they count as part of what a refit closes"
        )
        remedy = "fit the run longer if that part is large"
        findings.append(Finding("warn", "law of the run", source, what, why, remedy))
    if sim.outlier_spans:
        spans_by_file: dict[str, list[str]] = {}
        for span in sim.outlier_spans:
            spans_by_file.setdefault(span.file, []).append(f"{span.start_s:.4g} to {span.stop_s:.4g} s")
        spans = ", ".join(f"{file} from {' and '.join(times)}" for file, times in spans_by_file.items())
        what = f"no law fits {spans} together with the rest; the sim was estimated without these outliers"
        why = f"{unrecorded}, or the mechanism was different"
        remedy = "look at what happened there, and cut it out"
        findings.append(Finding("warn", "disturbed sim", "sim", what, why, remedy))
    return findings
