"""How well a recording excites each effect, and what to record where it does not.

Each effect grades a recording itself, from its measures; this module holds what several effects say alike and
collects the grades of the whole catalogue.
"""

from collections.abc import Sequence
from dataclasses import dataclass

from lagsplat.diagnose.data_quality.excitation_measures import (
    ExcitationMeasures,
    InputMeasures,
    measure_excitation,
)
from lagsplat.diagnose.data_quality.noise import MeasurementNoise
from lagsplat.diagnose.effects.base import Effect, Grade, InputEffect
from lagsplat.diagnose.effects.registry import list_effects
from lagsplat.io.trajectory.trajectory import Trajectory


@dataclass(frozen=True)
class Excitation:
    """Whether a recording excites one effect."""

    effect: str
    excited: str  # `yes`, `weak` or `no`
    reason: str
    record: str  # what to record next; empty where the effect is excited
    inputs: tuple[str, ...] = ()  # inputs that excite it, if it is an effect of an input


def assess_excitation(
    trajectories: Sequence[Trajectory],
    *,
    period_s: float,
    noise: MeasurementNoise,
    closed_loop: Sequence[str] = (),
) -> tuple[Excitation, ...]:
    """Grade a recording for every effect of the catalogue, effects of inputs last."""
    measures = measure_excitation(trajectories, period_s=period_s, noise=noise)
    rows = []
    for effect in sorted(list_effects(), key=lambda effect: isinstance(effect, InputEffect)):
        inputs: tuple[str, ...] = ()
        if isinstance(effect, InputEffect):
            grade, inputs = _grade_inputs(effect, measures, closed_loop)
        else:
            grade = effect.excitation(measures)
        record = "" if grade.excited == "yes" else grade.record
        rows.append(Excitation(effect.name, grade.excited, grade.reason, record, inputs))
    return tuple(rows)


def _grade_inputs(
    effect: Effect, measures: ExcitationMeasures, closed_loop: Sequence[str]
) -> tuple[Grade, tuple[str, ...]]:
    """The grade of the inputs that excite it best, and their names; in a closed loop one counts as weak."""
    moving = [channel for channel in measures.inputs if channel.moves]
    grades = {channel.name: effect.excitation(channel, measures) for channel in moving}
    if not grades:
        reason = "all inputs are constant" if measures.inputs else "no input is recorded"
        record = (
            f"record {20 * measures.period_s:.3g} s with the input swinging through zero, slowly and up to "
            "twice the natural frequency"
        )
        return Grade("no", reason, record), ()
    for name in closed_loop:
        if name in grades and grades[name].excited == "yes":
            grades[name] = Grade("weak", f"{name} answers the motion", "drive it open loop")
    best = max(grades.values(), key=lambda grade: ("no", "weak", "yes").index(grade.excited))
    inputs = tuple(name for name, grade in grades.items() if grade.excited == best.excited != "no")
    return best, inputs


def make_grade(yes: bool, weak: bool, reason: str, record: str) -> Grade:
    """``yes`` and ``weak`` as a grade, the better one that holds."""
    return Grade("yes" if yes else "weak" if weak else "no", reason, record)


def describe_swings(measures: ExcitationMeasures) -> str:
    """The number of swings and the range of their sizes."""
    return f"{measures.periods:.3g} periods, large swings {measures.amplitude_ratio:.2g} times the small ones"


def describe_reversals(measures: ExcitationMeasures) -> str:
    """The number of reversals, and of swings with the range of their sizes."""
    return f"{measures.reversals} reversals, {describe_swings(measures)}"


def ask_for_decay(measures: ExcitationMeasures, periods: float = 10.0) -> str:
    """Ask for a free decay over so many natural periods."""
    length_s = periods * measures.period_s
    return f"let it go from a large deflection and record {length_s:.3g} s, until it is at rest"


def ask_for_steps(measures: ExcitationMeasures) -> str:
    """Ask for inputs that are held long enough to show the static response."""
    return f"drive it by steps held for {3 * measures.period_s:.3g} s each, with the input recorded"


def grade_timing(measures: ExcitationMeasures, record: str) -> Grade:
    """Errors of single time stamps show where the motion between two samples exceeds the noise."""
    reason = f"between two samples it moves {measures.step_over_noise:.2g} times the noise"
    return make_grade(measures.step_over_noise > 4, measures.step_over_noise > 1, reason, record)


def grade_fast_input(channel: InputMeasures, measures: ExcitationMeasures) -> Grade:
    """A late response shows with steps of the input, or with frequencies above the natural one."""
    reason = f"{channel.name} has {channel.steps} step(s) and reaches {channel.high:.2g} natural frequencies"
    record = f"drive it by steps, or up to twice the natural frequency ({1 / measures.period_s:.3g} Hz)"
    return make_grade(channel.steps >= 3 or channel.high > 1.2, channel.high > 0.4, reason, record)


def grade_inertia(measures: ExcitationMeasures) -> Grade:
    """It shows apart from stiffness and damping where inputs are known below and at the natural frequency."""
    broad = measures.driven and any(channel.low < 0.5 and channel.high > 0.8 for channel in measures.inputs)
    reason = "inputs below and at the natural frequency" if broad else "only the ratio to stiffness shows"
    return make_grade(broad and measures.periods > 3, measures.periods > 2, reason, ask_for_steps(measures))
