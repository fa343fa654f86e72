"""A diagnosis in one paragraph that needs no training in mechanics, and the names in its sentences."""

import math
from collections.abc import Mapping, Sequence, Set
from typing import Any

from lagsplat.diagnose.core.result import Candidate, Diagnosis
from lagsplat.diagnose.effects.base import InputEffect
from lagsplat.diagnose.effects.registry import (
    VERDICTS,
    catalogue,
    describe_effect,
    label_parameter,
    short_title,
)
from lagsplat.report.common.formatting import (
    append_unit,
    capitalize_first,
    format_interval,
    format_number,
    format_percent,
    format_probability,
    list_numbers,
)
from lagsplat.report.diagnosis.content import (
    NEXT_INPUTS,
    compute_remaining,
    find_main_coordinate,
    list_excited,
    list_findings,
    list_joints,
    read_location,
    recommend_recordings,
)

CERTAIN_FROM = 0.8  # probability from which the summary says "the cause"
LIKELY_FROM = 0.5  # probability from which it says "the likely cause"
UNEXPLAINED_RATIO = 1.25  # remaining gap over its floor, above which something else is missing too
FULL_PERIOD = 0.85  # natural periods from which a horizon counts as one
SUBSTANTIAL_SHARE = 0.5  # misfit of several effects over that of the nearest, below which they are mentioned
MAX_NAMED = 4  # effects that a sentence lists
MIN_EVENT_SHARE = 0.5  # share of the residual from which the summary mentions a short event
HEADLINES = {
    "none": "No gap beyond the sim's own uncertainty",
    "unknown": "A gap that no known effect explains",
    "undetermined": "This recording cannot decide",
}
JOINT_VERDICTS = {
    "none": "no gap",
    "unknown": "a gap that no known effect explains",
    "undetermined": "undecided",
}
LEVEL_TITLES = {
    "perception": "The gap arises in the measurement itself, in the sensor or its clock, before any physics",
    "chart": "The gap lies in how positions are read, not in the forces",
    "actuation": "The gap lies in how the inputs act",
    "dynamics": "The gap lies in the motion itself",
}
ACTS_LIKE = {
    "inertial": "a change of mass",
    "conservative": "a spring or a weight",
    "dissipative": "a loss of energy",
    "actuation": "a change of the inputs",
    "exogenous": "something from outside",
    "memory": "something that remembers the past",
}
CONSEQUENCES = {
    "parameter": "This is a parameter change: the simulation lacks no physics, and a refit suffices.",
    "observation": "The fault is in the sensor or its clock; the mechanism moves as simulated.",
    "outside": "The mechanism itself moves as simulated.",
}
"""What it means if all effects found are of one kind."""
WITHIN_TOLERANCE = (
    "The gap is no larger than the tolerances of the simulation's own numbers allow: a number is off rather "
    "than physics missing."
)
NUMERALS = ("No", "One", "Two", "Three")


def write_summary(diagnosis: Diagnosis) -> str:
    """Write the verdict, its evidence and what to do, in a few sentences of plain text."""
    writers = {
        "effect": _write_effect,
        "none": _write_none,
        "unknown": _write_unknown,
        "undetermined": _write_undetermined,
    }
    sentences = [*writers[diagnosis.verdict](diagnosis), _mention_joints(diagnosis)]
    return " ".join(sentence for sentence in sentences if sentence)


def write_headline(diagnosis: Diagnosis) -> str:
    """Write the verdict in a few words."""
    if diagnosis.verdict != "effect":
        return HEADLINES[diagnosis.verdict]
    equivalent = list_indistinguishable(diagnosis)
    if not is_named(diagnosis):
        return "A gap whose cause is undecided"
    if len(equivalent) > 1 and len(diagnosis.combination) < 2:
        return capitalize_first(join_texts([short_title(name) for name in equivalent], "or"))
    return capitalize_first(
        join_texts([name_candidate(effect) for effect in select_chosen(diagnosis)], "and")
    )


def is_named(diagnosis: Diagnosis) -> bool:
    """Whether the headline names a cause: an effect, or several that the recording cannot distinguish."""
    names = list_indistinguishable(diagnosis) if diagnosis.verdict == "effect" else []
    return sum(sum_probability(diagnosis, name) for name in names) >= LIKELY_FROM


def _write_effect(diagnosis: Diagnosis) -> list[str]:
    chosen, equivalent = select_chosen(diagnosis), list_indistinguishable(diagnosis)
    if not chosen:
        return _write_unknown(diagnosis)
    probability = sum(sum_probability(diagnosis, name) for name in equivalent)
    sentences = [_describe_size(diagnosis), _describe_place(diagnosis)]
    if not is_named(diagnosis):
        first = [candidate for candidate in diagnosis.candidates if candidate.name != "none"][:3]
        sentences.append(f"Its cause is undecided; most probable are {_list_probable(first)}.")
        return [*sentences, _recommend_next(diagnosis)]
    kinds = {describe_effect(effect.name).kind for effect in chosen}
    sentences.append(_describe_cause(diagnosis, chosen, equivalent, probability))
    sentences += [_list_estimates(e, len(chosen), len(equivalent)) for e in chosen if e.parameters]
    sentences += [text for kind, text in CONSEQUENCES.items() if kinds == {kind}]
    sentences += [WITHIN_TOLERANCE] if diagnosis.checks.get("within_tolerance") else []
    sentences.append(_describe_closure(diagnosis, _name_remedy(kinds, len(chosen), equivalent)))
    if len(equivalent) == 1:
        sentences += [describe_effect(effect.name).remedy for effect in chosen]
    return [*sentences, _recommend_next(diagnosis)]


def name_joint_cause(row: Mapping[str, Any]) -> str:
    """Name what was found at one of several joints, such as "viscous damping at j1" or "no gap"."""
    if row["verdict"] != "effect":
        return JOINT_VERDICTS[row["verdict"]]
    found = [Candidate(each["name"], 1.0, each["coordinate"], each["input"]) for each in row["effects"]]
    return join_texts([name_candidate(candidate) for candidate in found], "and")


def _mention_joints(diagnosis: Diagnosis) -> str:
    """Say what was found at the joints that do not lead, where each was diagnosed by itself."""
    rows = [row for row in list_joints(diagnosis) if row["joint"] not in diagnosis.q_names]
    if not rows:
        return ""
    parts = [f"{row['joint']}: {name_joint_cause(row)}" for row in rows]
    return (
        f"All this is of joint {diagnosis.q_names[0]}, while the other joints move as recorded. They were "
        f"diagnosed likewise: {'; '.join(parts)}."
    )


def _write_none(diagnosis: Diagnosis) -> list[str]:
    chance = format_probability(sum_probability(diagnosis, "none"))
    sentences = [f"The simulation agrees with the recording: nothing has to be added (probability {chance})."]
    sentences.append(_compare_miss(diagnosis, "its forecasts miss", "even the true model would miss by"))
    sentences.append(_mention_immaterial(diagnosis))
    invisible = list_excited(diagnosis, "no")
    if invisible:
        more = len(invisible) - MAX_NAMED
        titles = [short_title(name) for name in invisible[:MAX_NAMED]]
        titles += [f"{more} others"] if more > 0 else []
        sentences.append(f"This recording could not have shown {join_texts(titles, 'or')}.")
        sentences.append(_recommend_next(diagnosis))
    return sentences


def _write_unknown(diagnosis: Diagnosis) -> list[str]:
    chance = format_probability(sum_probability(diagnosis, "unknown"))
    known = _list_effect_candidates(diagnosis)
    nearest = name_candidate(known[0]) if known else "An outer force"
    sentences = [
        _describe_size(diagnosis),
        _describe_place(diagnosis),
        f"No effect of the catalogue explains it (probability {chance}).",
    ]
    if known:
        left = compute_remaining(diagnosis.gap, known[0].closure).value
        much = "more than noise" if left is None else f"{format_percent(left)}, more than noise"
        sentences.append(
            f"The nearest, {nearest}, would leave {much}; it should not be taken for the cause, since a "
            "wrong effect often removes much of a gap."
        )
        sentences.append(_mention_combination(diagnosis))
    sentences.append(_mention_immaterial(diagnosis))
    return [*sentences, describe_effect("unknown").remedy, _recommend_next(diagnosis)]


def _mention_immaterial(diagnosis: Diagnosis) -> str:
    """Mention effects that are there and too small to matter."""
    found = diagnosis.checks.get("immaterial")
    if not found:
        return ""
    names = join_texts([short_title(name) for name in found["effects"]], "and")
    share = format_percent(max(found["share"]["value"], 0.0))
    return f"{capitalize_first(names)} can be seen but hardly matters: {share} of the gap beyond a refit."


def _mention_combination(diagnosis: Diagnosis) -> str:
    """Mention several effects that together leave far less than the nearest alone."""
    noise = max(diagnosis.checks.get("sim_misfit", 1.0), 1.0)
    left = [max(step["misfit"] - noise, 0.0) for step in diagnosis.checks.get("chain", [])]
    if len(left) < 2 or not left[-1] < SUBSTANTIAL_SHARE * left[0]:
        return ""
    names = [short_title(name) for name in diagnosis.checks["chain"][-1]["effects"]]
    share = format_percent(left[-1] / left[0])
    return f"Nearer are {join_texts(names, 'and')} together, which leave {share} as much."


def _write_undetermined(diagnosis: Diagnosis) -> list[str]:
    why = explain_undecided(diagnosis).rstrip(".")
    sentences = [
        f"This recording cannot decide what is wrong with the simulation, if anything: {why}.",
        _describe_size(diagnosis),
    ]
    first = _list_effect_candidates(diagnosis)[:3]
    if first and first[0].probability > 0.0:
        sentences.append(f"Most probable so far: {_list_probable(first)}; none of them is established.")
    return [*sentences, _recommend_next(diagnosis)]


def explain_undecided(diagnosis: Diagnosis) -> str:
    """The main reason why nothing can be decided; a general sentence where none is given."""
    reasons = diagnosis.checks.get("undetermined")
    if reasons:
        return reasons if isinstance(reasons, str) else str(reasons[0])
    for finding in list_findings(diagnosis):
        if finding["level"] == "undetermined":
            return f"{finding['what']}; {finding['why']}"
    return next(iter(diagnosis.warnings), "the candidates explain the recording about equally well")


def _describe_size(diagnosis: Diagnosis) -> str:
    gap = diagnosis.gap
    if gap is None:
        return ""
    subject = "the simulation's forecasts miss the measurement"
    text = _compare_miss(diagnosis, subject, f"{name_floor(diagnosis)} alone would leave")
    lost, added = gap.diverged.get("before", 0), gap.diverged.get("after", 0)
    if lost or added:
        with_it = f" and {added} with what is added to it" if added else ""
        text += f" Of {gap.blocks} forecasts {lost} of the simulation{with_it} diverged; all count."
    return text


def name_floor(diagnosis: Diagnosis) -> str:
    """What leaves a miss where nothing is missing: noise and, for a learned law, its own error."""
    return "noise and the sim's own error" if diagnosis.checks.get("own_error") else "noise"


def _compare_miss(diagnosis: Diagnosis, subject: str, best: str) -> str:
    """Say by how much the simulation's forecasts miss, over which time, and what ``best`` forecasts would."""
    gap = diagnosis.gap
    if gap is None:
        return ""
    over = "one natural period"
    if math.isfinite(gap.horizon_s):
        periods = gap.horizon_s / diagnosis.checks.get("natural_period_s", gap.horizon_s)
        duration = f"{format_number(gap.horizon_s)} s"
        part = f"{duration}, {format_number(periods)} of a natural period"
        over = f"{over} ({duration})" if periods > FULL_PERIOD else part
    floor = f"; {best} {format_percent(gap.floor)}" if math.isfinite(gap.floor) else ""
    return f"Over {over}, {subject} by {format_percent(gap.before)} of the size of the motion{floor}."


def _describe_place(diagnosis: Diagnosis) -> str:
    location = read_location(diagnosis)
    level = location.get("level")
    if level not in LEVEL_TITLES:
        return ""
    text = LEVEL_TITLES[level]
    shares, main = location.get("coordinates") or {}, find_main_coordinate(diagnosis)
    if main is not None and len(shares) > 1:
        text += f", mostly in {main} ({format_percent(shares[main])})"
    components = location.get("components") or {}
    best = max(components, key=lambda name: components[name], default="unexplained")
    if level == "dynamics" and best in ACTS_LIKE:
        text += f", and acts like {ACTS_LIKE[best]} ({format_percent(components[best])})"
    for file, start_s, end_s, share in (location.get("time_s") or ())[:1]:
        if share >= MIN_EVENT_SHARE and end_s - start_s < diagnosis.checks.get("natural_period_s", 0.0):
            span = f"between {start_s:.4g} and {end_s:.4g} s of {file}"
            return f"{text}. {format_percent(share)} of what is missing acts {span}."
    return f"{text}."


def _list_probable(candidates: list[Candidate]) -> str:
    texts = []
    for candidate in candidates:
        unknown = candidate.name == "unknown"
        name = describe_effect("unknown").title if unknown else name_candidate(candidate)
        texts.append(f"{name} ({format_probability(candidate.probability)})")
    return join_texts(texts, "and")


def _describe_cause(
    diagnosis: Diagnosis, chosen: list[Candidate], equivalent: list[str], probability: float
) -> str:
    verb = "The cause is" if probability >= CERTAIN_FROM else "The likely cause is"
    together = format_probability(probability)
    what = " ".join(describe_effect(effect.name).what for effect in chosen)
    titles = join_texts([name_candidate(effect) for effect in chosen], "and")
    if len(chosen) > 1:
        number = NUMERALS[len(chosen)]
        return f"{number} effects act together: {titles} (the first with probability {together}). {what}"
    if len(equivalent) > 1:
        texts = [
            f"{short_title(name)} ({format_probability(sum_probability(diagnosis, name))})"
            for name in equivalent
        ]
        return (
            f"{verb} one of these, which this recording cannot distinguish: {join_texts(texts, 'or')}; "
            f"together they have probability {together}."
        )
    return f"{verb} {titles} (probability {together}). {what}"


def _list_estimates(candidate: Candidate, chosen: int, equivalent: int) -> str:
    opening = "Estimated" if chosen == 1 else f"Estimated for {name_candidate(candidate)}"
    if equivalent > 1:
        opening = f"If it is {short_title(candidate.name)}"
    return f"{opening}: {'; '.join(format_estimates(candidate))}."


def _name_remedy(kinds: Set[str], together: int, names: list[str]) -> str:
    if len(names) > 1:
        return f"Adding {short_title(names[0])} to the simulation"
    if together > 1:
        return "Adding them to the simulation"
    if kinds == {"observation"}:
        return "Allowing for it"
    return "Setting it right" if kinds == {"parameter"} else "Adding it to the simulation"


def _describe_closure(diagnosis: Diagnosis, remedy: str) -> str:
    gap = diagnosis.gap
    if gap is None:
        return ""
    if gap.closure.value is None:
        floor = name_floor(diagnosis)
        return f"How far that shrinks the gap is unknown: it hardly exceeds what {floor} leaves."
    before, after = format_percent(gap.before), format_percent(gap.after)
    left = compute_remaining(gap, gap.closure)
    if left.low is not None and left.high is not None:
        after += f" (95 % interval {format_percent(left.low)} to {format_percent(left.high)})"
    text = f"{remedy} shrinks the miss from {before} to {after}"
    if gap.after >= gap.before:
        text = f"{remedy} does not shrink the miss of held-out forecasts ({after} with it)"
    if math.isfinite(gap.refit):
        refit = format_percent(gap.refit)
        text += f"; moving the simulation's own numbers within their uncertainty leaves {refit}"
    text += "."
    if gap.floor > 0.0 and gap.after > UNEXPLAINED_RATIO * gap.floor:
        times, floor = format_number(gap.after / gap.floor), name_floor(diagnosis)
        text += f" What remains is {times} times what {floor} leaves, so that something else is missing too."
    return text


def _recommend_next(diagnosis: Diagnosis) -> str:
    planned = diagnosis.next_experiments
    if planned is not None:
        if not planned.suggestions:
            return f"{planned.reason}."
        first = planned.suggestions[0]
        played = f"; its inputs are in {NEXT_INPUTS.format(1)}" if len(first.input) > 1 else ""
        return f"{first.text}{played}."
    for effect, record in recommend_recordings(diagnosis)[:1]:
        return f"To know more of {short_title(effect)}, record this next: {record.rstrip('.')}."
    return ""


def select_chosen(diagnosis: Diagnosis) -> list[Candidate]:
    """Select the effects of the combination in its order; the most probable effect where there is none."""
    candidates = diagnosis.candidates
    chosen = [next(item for item in candidates if item.name == name) for name in diagnosis.combination]
    return chosen or _list_effect_candidates(diagnosis)[:1]


def _list_effect_candidates(diagnosis: Diagnosis) -> list[Candidate]:
    return [candidate for candidate in diagnosis.candidates if candidate.name not in VERDICTS]


def list_indistinguishable(diagnosis: Diagnosis) -> list[str]:
    """List the first chosen effect and those equivalent to it in this recording, most probable first."""
    if not select_chosen(diagnosis):
        return []
    name = select_chosen(diagnosis)[0].name
    others = {other for group in diagnosis.equivalent if name in group for other in group}
    return sorted({name} | others, key=lambda other: (-sum_probability(diagnosis, other), other != name))


def sum_probability(diagnosis: Diagnosis, name: str) -> float:
    """Sum the probability of an effect over the places where it may act."""
    return sum(candidate.probability for candidate in diagnosis.candidates if candidate.name == name)


def name_second_forecast(diagnosis: Diagnosis) -> str:
    """Name the second of two forecasts: the sim with effects, or only refitted where none was chosen."""
    return "sim with effects" if diagnosis.combination else "sim, refit"


def name_candidate(candidate: Candidate) -> str:
    """Name an effect and its place, such as "Coulomb friction at q1"."""
    coordinate, source = _name_places(candidate)
    at, of = f" at {coordinate}" if coordinate else "", f" of {source}" if source else ""
    return f"{short_title(candidate.name)}{at}{of}"


def _name_places(candidate: Candidate) -> tuple[str | None, str | None]:
    """The coordinates and the inputs where an effect acts, as in a sentence."""
    if not candidate.places:
        return candidate.coordinate, candidate.input
    several = join_texts(candidate.places, "and")
    on_inputs = isinstance(catalogue().get(candidate.name), InputEffect)
    return (None, several) if on_inputs else (several, None)


def format_estimates(candidate: Candidate) -> list[str]:
    """Format each parameter with its unit and its 90 % interval."""
    texts = []
    for name, parameter in candidate.parameters.items():
        numbers = list_numbers(parameter.value)
        bounds = [_match_bounds(bound, len(numbers)) for bound in (parameter.low, parameter.high)]
        intervals = [format_interval(*row) for row in zip(numbers, *bounds, strict=True)]
        value = ", ".join(text for text, _, _ in intervals) or "–"
        text = f"{label_parameter(candidate.name, name)} {append_unit(value, parameter.unit)}"
        if not isinstance(parameter.value, list | tuple) and intervals[0][1] != "–":
            text += f" (90 % interval {intervals[0][1]} to {intervals[0][2]})"
        texts.append(text)
    return texts


def join_texts(texts: Sequence[str], word: str) -> str:
    """Join texts as in a sentence, with ``word`` before the last."""
    if len(texts) < 2:
        return "".join(texts)
    return f"{', '.join(texts[:-1])} {word} {texts[-1]}"


def _match_bounds(bound: object, count: int) -> list[float | None]:
    """``count`` bounds, all None where the number of bounds is another."""
    bounds: list[float | None] = list(list_numbers(bound))
    return bounds if len(bounds) == count else [None] * count
