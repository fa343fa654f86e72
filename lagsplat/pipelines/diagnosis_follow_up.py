"""What follows a verdict: whether each of several files agrees with it, and what to record next."""

from dataclasses import replace

from lagsplat.diagnose.core.config import DiagnoseConfig
from lagsplat.diagnose.core.result import FileAgreement, NextExperiments
from lagsplat.diagnose.diagnosis import DiagnosisRun
from lagsplat.diagnose.experiment.planning import plan_experiments, select_leaders
from lagsplat.diagnose.inference.consistency import check_files
from lagsplat.pipelines.diagnosis_inputs import DiagnosisInputs

MAX_RIVALS = 3
"""Effects, the most probable first, that a single file may prefer to the common one."""
CERTAIN_NONE = 0.9
"""Probability of `none` from which nothing is planned against an effect that hardly acts."""


def look_further(inputs: DiagnosisInputs, run: DiagnosisRun, config: DiagnoseConfig) -> DiagnosisRun:
    """Add what needs a verdict first: whether each file agrees with it, and what to record next."""
    files, diagnosis = _check_files(inputs, run, config), run.diagnosis
    odd = [
        f"{each.file} disagrees with the other files: {each.disagrees}" for each in files if each.disagrees
    ]
    diagnosis = replace(
        diagnosis,
        files=files,
        warnings=(*diagnosis.warnings, *odd),
        next_experiments=_plan_next(inputs, run, config),
    )
    return replace(run, diagnosis=diagnosis)


def _check_files(
    inputs: DiagnosisInputs, run: DiagnosisRun, config: DiagnoseConfig
) -> tuple[FileAgreement, ...]:
    """Whether the explanation of all files holds in each; where nothing is named, the nearest one."""
    best = [run.ranking.best_fit(each.name) for each in run.diagnosis.candidates]
    effects = [fit for fit in best if fit is not None and not fit.moves_samples]
    unknown = not run.chosen.effects and run.diagnosis.verdict == "unknown" and effects
    chosen = effects[0] if unknown else run.chosen
    rivals = [fit for fit in (run.ranking.none, *effects[:MAX_RIVALS]) if fit is not chosen]
    return check_files(
        run.problem,
        chosen,
        rivals,
        given=(inputs.sim.original or inputs.sim).model,
        noise_inflation=run.ranking.noise_inflation,
        materiality=config.materiality,
    )


def _plan_next(inputs: DiagnosisInputs, run: DiagnosisRun, config: DiagnoseConfig) -> NextExperiments | None:
    """What separates the two leading hypotheses; None where there are not two, or `none` is certain.

    None as well where an input was computed, which nobody can play.
    """
    if inputs.real[0].computed:
        return None
    first = run.diagnosis.candidates[0]
    leaders = select_leaders(run.diagnosis.candidates, run.ranking, run.chosen)
    if not leaders or (first.name == "none" and first.probability >= CERTAIN_NONE):
        return None
    return plan_experiments(
        run.problem,
        leaders,
        noise_inflation=run.ranking.noise_inflation,
        window_s=config.window_periods * inputs.sim.window_scale * run.problem.period_s,
        q_names=run.diagnosis.q_names,
        u_names=run.diagnosis.u_names,
    )
