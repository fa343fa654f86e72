"""What was named in a diagnosis, and how it is called in a sentence.

A diagnosis in one paragraph that needs no training in mechanics.
"""

import math
from collections.abc import Set

from lagsplat.diagnose.core.result import Candidate, Diagnosis, Gap
from lagsplat.diagnose.effects.base import InputEffect
from lagsplat.diagnose.effects.registry import catalogue, describe_effect, label_parameter, short_title
from lagsplat.report.common.formatting import (
    append_unit,
    format_interval,
    format_number,
    format_percent,
    format_probability,
    list_numbers,
)
from lagsplat.report.diagnosis.content import (
    describe_event,
    explain_undecided,
    find_main_coordinate,
    get_location,
    read_excitations,
    recommend_recordings,
    select_effects,
)


def select_chosen(diagnosis: Diagnosis) -> list[Candidate]:
    """The effects that were named, in the order of the combination; the most probable where there is none."""
    found = [next(one for one in diagnosis.candidates if one.name == name) for name in diagnosis.combination]
    return found or [one for one in diagnosis.candidates if one.name not in ("none", "unknown")][:1]


def list_indistinguishable(diagnosis: Diagnosis) -> list[str]:
    """The first chosen effect and those this recording cannot tell from it, most probable first."""
    if not select_chosen(diagnosis):
        return []
    name = select_chosen(diagnosis)[0].name
    others = {other for group in diagnosis.equivalent if name in group for other in group}
    return sorted({name} | others, key=lambda other: (-sum_probability(diagnosis, other), other != name))


def sum_probability(diagnosis: Diagnosis, name: str) -> float:
    """Probability of an effect, wherever it acts."""
    return sum(one.probability for one in diagnosis.candidates if one.name == name)


def name_second_forecast(diagnosis: Diagnosis) -> str:
    """What the augmented forecasts are of: the sim with its effects, or refit where none was chosen."""
    return "sim with effects" if diagnosis.combination else "sim, refit"


def name_candidate(candidate: Candidate) -> str:
    """An effect and where it acts, such as "Coulomb friction at q1"."""
    coordinate, source = _spots(candidate)
    at = [f"at {coordinate}"] if coordinate else []
    of = [f"of {source}"] if source else []
    return " ".join([short_title(candidate.name), *at, *of])


def _spots(candidate: Candidate) -> tuple[str | None, str | None]:
    """The coordinates and the inputs where it acts, as read in a sentence."""
    if not candidate.places:
        return candidate.coordinate, candidate.input
    several = " and ".join([", ".join(candidate.places[:-1]), candidate.places[-1]])
    on_inputs = isinstance(catalogue().get(candidate.name), InputEffect)
    return (None, several) if on_inputs else (several, None)


def title_candidate(candidate: Candidate) -> str:
    """The title with its place, such as "a delay of input u0"."""
    title = describe_effect(candidate.name).title
    coordinate, source = _spots(candidate)
    inputs = "inputs" if candidate.places else "input"
    if source and "an input" in title:
        title = title.replace("an input", f"{inputs} {source}")
    elif source:
        title += f", on {inputs} {source}"
    return f"{title} at {coordinate}" if coordinate else title


def format_estimates(candidate: Candidate) -> list[str]:
    """Each parameter with unit and 90 % interval, one text each."""
    told = []
    for name, one in candidate.parameters.items():
        several = isinstance(one.value, list | tuple)
        rows = zip(
            list_numbers(one.value), _bounds(one.low, one.value), _bounds(one.high, one.value), strict=True
        )
        texts = [format_interval(*row) for row in rows]
        value = ", ".join(text for text, _, _ in texts) or "–"
        bounds = "" if several or texts[0][1] == "–" else f" (90 % interval {texts[0][1]} to {texts[0][2]})"
        label = label_parameter(candidate.name, name)
        told.append(f"{label} {append_unit(value, one.unit)}{bounds}")
    return told


def split_closure(gap: Gap) -> tuple[float, float] | None:
    """What refitting alone takes away and what the effects take, of what lies above the floor."""
    above = gap.before - gap.floor
    if not above > 0.0 or not math.isfinite(gap.refit):
        return None
    return (gap.before - gap.refit) / above, (gap.refit - gap.after) / above


def join_texts(texts: list[str], word: str) -> str:
    """Texts as a list in a sentence, ``word`` before the last."""
    if len(texts) < 2:
        return "".join(texts)
    return f"{', '.join(texts[:-1])} {word} {texts[-1]}"


def _bounds(bound: object, value: object) -> list[float | None]:
    found: list[float | None] = list(list_numbers(bound))
    return found if len(found) == len(list_numbers(value)) else [None] * len(list_numbers(value))


CERTAIN_FROM, LIKELY_FROM = (
    0.8,
    0.5,
)  # probability of a class from which it is called the cause, and the likely cause
UNEXPLAINED_RATIO = 1.25  # times the floor: above it something else is missing too
ADVICE_FROM = 0.01  # probability from which on it is worth a recording to know more of an effect
FULL_PERIOD = 0.85  # natural periods from which on a horizon counts as one
SUBSTANTIAL_SHARE = 0.5  # share of what the nearest effect leaves at which several together are told of
MAX_NAMED = 4  # effects that a sentence lists at most
LEVEL_TITLES = {
    "perception": "The gap arises where the pictures are read, before any physics",
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
NUMERALS = ("No", "One", "Two", "Three")


def write_summary(diagnosis: Diagnosis) -> str:
    """The verdict, what it rests on and what to do, in a few sentences of plain text."""
    tell = {"effect": _effect, "none": _none, "unknown": _unknown, "undetermined": _undetermined}
    return " ".join(sentence for sentence in tell[diagnosis.verdict](diagnosis) if sentence)


def write_headline(diagnosis: Diagnosis) -> str:
    """The verdict in a few words."""
    if diagnosis.verdict != "effect":
        return {
            "none": "No gap beyond the sim's own uncertainty",
            "unknown": "A gap that no known effect explains",
            "undetermined": "This recording cannot decide",
        }[diagnosis.verdict]
    names = list_indistinguishable(diagnosis)
    if sum(sum_probability(diagnosis, name) for name in names) < LIKELY_FROM:
        return "A gap whose cause is undecided"
    if len(diagnosis.combination) > 1:
        return _capital(join_texts([name_candidate(one) for one in select_chosen(diagnosis)], "and"))
    if len(names) > 1:
        return _capital(join_texts([short_title(name) for name in names], "or"))
    return _capital(name_candidate(select_chosen(diagnosis)[0]))


def _effect(diagnosis: Diagnosis) -> list[str]:
    named, names = select_chosen(diagnosis), list_indistinguishable(diagnosis)
    if not named:
        return _unknown(diagnosis)
    together = sum(sum_probability(diagnosis, name) for name in names)
    kinds = {describe_effect(one.name).kind for one in named}
    sentences = [_size(diagnosis), _located(diagnosis), _cause(diagnosis, named, names, together)]
    if together >= LIKELY_FROM:
        sentences += [_estimated(one, len(named), len(names)) for one in named if one.parameters]
        sentences.append(_consequence(kinds))
        sentences.append(_closure(diagnosis, _act(kinds, len(named), names)))
        sentences += [describe_effect(one.name).remedy for one in named] if len(names) == 1 else []
    return [*sentences, _next(diagnosis)]


def _none(diagnosis: Diagnosis) -> list[str]:
    gap = diagnosis.gap
    chance = sum_probability(diagnosis, "none")
    agrees = "The simulation agrees with the recording: nothing has to be added"
    opening = f"{agrees} (probability {format_probability(chance)})."
    size = ""
    if gap is not None:
        floor = (
            f"; even the true model would miss by {format_percent(gap.floor)}"
            if math.isfinite(gap.floor)
            else ""
        )
        over = _over(gap, diagnosis)
        size = f"{over}, its forecasts miss by {format_percent(gap.before)} of the size of the motion{floor}."
    blind = select_effects(read_excitations(diagnosis), "no")
    caveat = f"This recording could not have shown {_listed(blind, 'or')}." if blind else ""
    return [opening, size, caveat, _next(diagnosis) if blind else ""]


def _unknown(diagnosis: Diagnosis) -> list[str]:
    chance = sum_probability(diagnosis, "unknown")
    known = [one for one in diagnosis.candidates if one.name not in ("none", "unknown")]
    doubt = diagnosis.checks.get("doubt")
    verb = "can be held responsible for" if doubt else "explains"
    sentences = [
        _size(diagnosis),
        _located(diagnosis),
        f"No effect of the catalogue {verb} it (probability {format_probability(chance)}).",
    ]
    if doubt:
        nearest = _capital(name_candidate(known[0])) if known else "An outer force"
        sentences.append(DOUBTS[doubt].format(nearest=nearest))
    elif known:
        closes = (known[0].closure and known[0].closure.value) or 0.0
        much = f" would close {format_percent(closes)} of it but" if closes > 0.0 else ""
        sentences.append(
            f"The nearest, {name_candidate(known[0])},{much} leaves more than noise behind; it should not be taken "
            f"for the cause, since a wrong effect often closes much of a gap.{_nearer(diagnosis)}"
        )
    return [*sentences, describe_effect("unknown").remedy, _next(diagnosis)]


def _nearer(diagnosis: Diagnosis) -> str:
    """What several effects together leave, where that is far less than the nearest alone does."""
    noise = max(diagnosis.checks.get("sim_misfit", 1.0), 1.0)
    left = [max(one["misfit"] - noise, 0.0) for one in diagnosis.checks.get("chain", [])]
    if len(left) < 2 or not left[-1] < SUBSTANTIAL_SHARE * left[0]:
        return ""
    names = [short_title(name) for name in diagnosis.checks["chain"][-1]["effects"]]
    return f" Nearer are {join_texts(names, 'and')} together, which leave {format_percent(left[-1] / left[0])} as much."


DOUBTS = {
    "unrepeated": "{nearest} would fit, but nothing shows that it comes from outside: in this recording the "
    "mechanism never passes through the same states without it, or not often enough.",
    "shapeless": "Only effects with times, frequencies or states of their own, several of them together, "
    "would fit; such effects fit almost anything.",
    "loose": "The simulation's own stiffness, damping, gains and loads, all moved together, fit better than "
    "any effect does: identify the simulation anew before looking for physics that it lacks.",
}
"""Why what leaves nothing unexplained is not believed all the same."""


def _undetermined(diagnosis: Diagnosis) -> list[str]:
    why = explain_undecided(diagnosis)[0].rstrip(".")
    sentences = [f"This recording cannot decide what is wrong with the simulation, if anything: {why}."]
    if diagnosis.gap is not None:
        sentences.append(_size(diagnosis))
    first = [one for one in diagnosis.candidates if one.name not in ("none", "unknown")][:3]
    if first and first[0].probability > 0.0:
        told = [f"{name_candidate(one)} ({format_probability(one.probability)})" for one in first]
        sentences.append(f"Most probable so far: {join_texts(told, 'and')}; none of them is established.")
    return [*sentences, _next(diagnosis)]


def _size(diagnosis: Diagnosis) -> str:
    gap = diagnosis.gap
    if gap is None:
        return ""
    floor = f"; noise alone would leave {format_percent(gap.floor)}" if math.isfinite(gap.floor) else ""
    return (
        f"{_over(gap, diagnosis)}, the simulation's forecasts miss the measurement by {format_percent(gap.before)} "
        f"of the size of the motion{floor}.{_runaways(gap)}"
    )


def _runaways(gap: Gap) -> str:
    """What forecasts that left the measurement do to the numbers, if any did."""
    lost, added = gap.diverged.get("before", 0), gap.diverged.get("after", 0)
    if not lost and not added:
        return ""
    with_it = f" and {added} with what is added to it" if added else ""
    return (
        f" Of {gap.blocks} forecasts {lost} of the simulation{with_it} left the motion for good; all count."
    )


def _over(gap: Gap, diagnosis: Diagnosis) -> str:
    if not math.isfinite(gap.horizon_s):
        return "Over one natural period"
    periods = gap.horizon_s / diagnosis.checks.get("natural_period_s", gap.horizon_s)
    if periods > FULL_PERIOD:
        return f"Over one natural period ({format_number(gap.horizon_s)} s)"
    return f"Over {format_number(gap.horizon_s)} s, {format_number(periods)} of a natural period"


def _located(diagnosis: Diagnosis) -> str:
    where = diagnosis.where
    level = get_location(where, "level")
    if level not in LEVEL_TITLES:
        return ""
    text = LEVEL_TITLES[level]
    shares = get_location(where, "coordinates") or {}
    main = find_main_coordinate(where)
    if main is not None and len(shares) > 1:
        text += f", mostly in {main} ({format_percent(shares[main])})"
    components = {k: v for k, v in (get_location(where, "components") or {}).items() if k in ACTS_LIKE}
    if level == "dynamics" and components and max(components.values()) >= 0.4:
        best = max(components, key=lambda name: components[name])
        text += f", and acts like {ACTS_LIKE[best]} ({format_percent(components[best])})"
    return f"{text}.{describe_event(where, diagnosis.checks.get('natural_period_s', 0.0))}"


def _cause(diagnosis: Diagnosis, named: list[Candidate], names: list[str], together: float) -> str:
    verb = "The cause is" if together >= CERTAIN_FROM else "The likely cause is"
    if together < LIKELY_FROM:
        first = [one for one in diagnosis.candidates if one.name != "none"][:3]
        told = [
            f"{describe_effect(one.name).title if one.name == 'unknown' else name_candidate(one)} "
            f"({format_probability(one.probability)})"
            for one in first
        ]
        return f"Its cause is undecided; most probable are {join_texts(told, 'and')}."
    if len(named) > 1:
        what = " ".join(describe_effect(one.name).what for one in named)
        return (
            f"{NUMERALS[len(named)]} effects act together: {join_texts([title_candidate(one) for one in named], 'and')} "
            f"(the first with probability {format_probability(together)}). {what}"
        )
    if len(names) > 1:
        told = [
            f"{describe_effect(name).title} ({format_probability(sum_probability(diagnosis, name))})"
            for name in names
        ]
        return (
            f"{verb} one of these, which this recording cannot tell apart: {join_texts(told, 'or')}; together "
            f"they have probability {format_probability(together)}."
        )
    chance = format_probability(together)
    return f"{verb} {title_candidate(named[0])} (probability {chance}). {describe_effect(named[0].name).what}"


def _consequence(kinds: Set[str]) -> str:
    if kinds == {"parameter"}:
        return "This is a parameter change: the simulation lacks no physics, and a refit suffices."
    if kinds == {"observation"}:
        return "The fault is in camera or timing; the mechanism moves as simulated."
    if kinds == {"outside"}:
        return "The mechanism itself moves as simulated."
    return ""


def _estimated(candidate: Candidate, together: int, alike_: int) -> str:
    if alike_ > 1:
        opening = f"If it is {short_title(candidate.name)}: "
    else:
        opening = "Estimated: " if together == 1 else f"Estimated for {name_candidate(candidate)}: "
    return f"{opening}{'; '.join(format_estimates(candidate))}."


def _act(kinds: Set[str], together: int, names: list[str]) -> str:
    if len(names) > 1:
        return f"Adding {short_title(names[0])} to the simulation"
    if together > 1:
        return "Adding them to the simulation"
    if kinds == {"observation"}:
        return "Allowing for it"
    return "Setting it right" if kinds == {"parameter"} else "Adding it to the simulation"


def _closure(diagnosis: Diagnosis, act: str) -> str:
    gap = diagnosis.gap
    if gap is None:
        return ""
    if gap.closure.value is None:
        return "How far it closes the gap cannot be told: the gap hardly exceeds what noise leaves."
    interval = ""
    if gap.closure.low is not None and gap.closure.high is not None:
        interval = f" (95 % interval {format_percent(gap.closure.low)} to {format_percent(gap.closure.high)})"
    share = f"{format_percent(gap.closure.value)} of what can be removed{interval}"
    if gap.closure.value >= 1.0:
        share = "as little as can be asked of forecasts from noisy beginnings"
    text = f"{act} shrinks the miss from {format_percent(gap.before)} to {format_percent(gap.after)}, which is {share}"
    if gap.after >= gap.before:
        text = f"{act} does not shrink the miss of held-out forecasts ({format_percent(gap.after)} with it)"
    shares = split_closure(gap)
    moved = "moving the simulation's own numbers within their uncertainty would remove"
    text += f"; {moved} {format_percent(shares[0])}." if shares and shares[0] > 0.0 else "."
    if gap.floor > 0.0 and gap.after > UNEXPLAINED_RATIO * gap.floor:
        times = format_number(gap.after / gap.floor)
        text += f" What remains is {times} times what noise leaves, so that something else is missing too."
    return text


def _next(diagnosis: Diagnosis) -> str:
    wanted = recommend_recordings(diagnosis)
    if not wanted:
        return ""
    effect, record = wanted[0]
    if diagnosis.verdict != "none" and sum_probability(diagnosis, effect) < ADVICE_FROM:
        return ""
    return f"To know more of {short_title(effect)}, record this next: {record.rstrip('.')}."


def _listed(names: list[str], word: str) -> str:
    more = len(names) - MAX_NAMED
    told = [short_title(name) for name in names[:MAX_NAMED]]
    return join_texts([*told, f"{more} others"] if more > 0 else told, word)


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
