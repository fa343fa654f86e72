"""What this recording can tell apart, family by family, and what to record where it cannot."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass

from lagsplat.diagnose.data_quality.excitation_measures import (
    ExcitationMeasures,
    InputMeasures,
    measure_excitation,
)
from lagsplat.diagnose.data_quality.noise import Noise
from lagsplat.diagnose.effects.excitation_rules import INPUT_RULES, RULES, Grade
from lagsplat.io.trajectory.trajectory import Trajectory


@dataclass(frozen=True)
class Excitation:
    """One family of effects: ``excited`` is ``yes``, ``weak`` or ``no``; the reason, and what to record next.

    ``record`` is empty where it is excited; ``inputs`` are the channels that excite an effect of an input.
    """

    effect: str
    excited: str
    reason: str
    record: str
    inputs: tuple[str, ...] = ()


def assess_excitation(
    motions: Sequence[Trajectory], *, period_s: float, noise: Noise, closed_loop: Sequence[str] = ()
) -> tuple[Excitation, ...]:
    """A row for every family of the catalogue; ``closed_loop`` names inputs that answer the motion.

    Source: signatures and the minimal excitation that separates them, as tabulated with each effect.
    """
    measures = measure_excitation(motions, period_s=period_s, noise=noise)
    rows = [_row(effect, rule(measures)) for effect, rule in RULES.items()]
    return (*rows, *(_input_row(effect, rule, measures, closed_loop) for effect, rule in INPUT_RULES.items()))


def _row(effect: str, grade: Grade, inputs: tuple[str, ...] = ()) -> Excitation:
    excited, reason, record = grade
    return Excitation(effect, excited, reason, "" if excited == "yes" else record, inputs)


def _input_row(
    effect: str,
    rule: Callable[[InputMeasures, ExcitationMeasures], Grade],
    measures: ExcitationMeasures,
    closed_loop: Sequence[str],
) -> Excitation:
    """The best channel speaks; one in a closed loop counts as weak."""
    order = ("no", "weak", "yes")
    graded = [(channel.name, rule(channel, measures)) for channel in measures.inputs if channel.moves]
    if not graded:
        reason = "all inputs are constant" if measures.inputs else "no input is recorded"
        return Excitation(effect, "no", reason, _drive_advice(measures))
    looped = [
        (name, ("weak", f"{name} answers the motion", "drive it open loop"))
        if name in closed_loop and grade[0] == "yes"
        else (name, grade)
        for name, grade in graded
    ]
    best = max((grade for _, grade in looped), key=lambda grade: order.index(grade[0]))
    return _row(effect, best, tuple(name for name, grade in looped if grade[0] == best[0] != "no"))


def _drive_advice(measures: ExcitationMeasures) -> str:
    return (
        f"record {20 * measures.period_s:.3g} s with the input swinging through zero, slowly and up to twice "
        "the natural frequency"
    )
