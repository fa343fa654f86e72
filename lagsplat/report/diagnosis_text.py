"""A diagnosis in one paragraph that needs no training in mechanics."""

import math

from lagsplat.diagnose.result import Candidate, Diagnosis, Gap
from lagsplat.report.diagnosis_checks import effects_shown, excitations, reasons
from lagsplat.report.diagnosis_where import located, main_coordinate
from lagsplat.report.effect_words import WORDS, short_title, words_of
from lagsplat.report.rounding import number, percent, probability, spread, values, with_unit

SURE, LIKELY = 0.8, 0.5  # probability of a class from which it is called the cause, and the likely cause
LEFT_OVER = 1.25  # times the floor: above it something else is missing too
NAMED = 4  # effects that a sentence lists at most
PLACES = {
    "perception": "It arises where the pictures are read, before any physics",
    "chart": "It lies in how positions are read, not in the forces",
    "actuation": "It lies in how the inputs act",
    "dynamics": "It lies in the motion itself",
}
ACTS_LIKE = {
    "inertial": "a change of mass",
    "conservative": "a spring or a weight",
    "dissipative": "a loss of energy",
    "actuation": "a change of the inputs",
    "exogenous": "something from outside",
    "memory": "something that remembers the past",
}


def paragraph(diagnosis: Diagnosis) -> str:
    """The verdict, what it rests on and what to do, in a few sentences of plain text."""
    tell = {"effect": _effect, "none": _none, "unknown": _unknown, "undetermined": _undetermined}
    return " ".join(sentence for sentence in tell[diagnosis.verdict](diagnosis) if sentence)


def headline(diagnosis: Diagnosis) -> str:
    """The verdict in a few words."""
    if diagnosis.verdict != "effect":
        return {
            "none": "No gap beyond the sim's own uncertainty",
            "unknown": "A gap that no known effect explains",
            "undetermined": "This recording cannot decide",
        }[diagnosis.verdict]
    names = alike(diagnosis)
    if len(diagnosis.combination) > 1:
        return _joined([_capital(place(one)) for one in chosen(diagnosis)], "and")
    if len(names) > 1:
        return _capital(_joined([short_title(name) for name in names], "or"))
    return _capital(place(chosen(diagnosis)[0]))


def chosen(diagnosis: Diagnosis) -> list[Candidate]:
    """The effects that were named, in the order of the combination; the most probable where there is none."""
    found = [
        next(one for one in diagnosis.candidates if one.name == name) for name in diagnosis.combination
    ]
    return found or [one for one in diagnosis.candidates if one.name not in ("none", "unknown")][:1]


def alike(diagnosis: Diagnosis) -> list[str]:
    """The first chosen effect and those this recording cannot tell from it, most probable first."""
    if not chosen(diagnosis):
        return []
    name = chosen(diagnosis)[0].name
    others = {other for group in diagnosis.equivalent if name in group for other in group}
    return sorted({name} | others, key=lambda other: (-_chance(diagnosis, other), other != name))


def place(candidate: Candidate) -> str:
    """An effect and where it acts, such as "Coulomb friction at q1"."""
    at = [f"at {candidate.coordinate}"] if candidate.coordinate else []
    of = [f"of {candidate.input}"] if candidate.input else []
    return " ".join([short_title(candidate.name), *at, *of])


def estimates(candidate: Candidate) -> list[str]:
    """Each parameter with unit and 90 % interval, one text each."""
    told = []
    for name, one in candidate.parameters.items():
        several = isinstance(one.value, list | tuple)
        rows = zip(values(one.value), _bounds(one.low, one.value), _bounds(one.high, one.value), strict=True)
        texts = [spread(*row) for row in rows]
        value = ", ".join(text for text, _, _ in texts) or "–"
        bounds = "" if several or texts[0][1] == "–" else f" (90 % interval {texts[0][1]} to {texts[0][2]})"
        told.append(f"{name.replace('_', ' ')} {with_unit(value, one.unit)}{bounds}")
    return told


def shares_of_closure(gap: Gap) -> tuple[float, float] | None:
    """What refitting alone takes away and what the effects take, of what lies above the floor."""
    above = gap.before - gap.floor
    if not above > 0.0 or not math.isfinite(gap.refit):
        return None
    return (gap.before - gap.refit) / above, (gap.refit - gap.after) / above


def _effect(diagnosis: Diagnosis) -> list[str]:
    named, names = chosen(diagnosis), alike(diagnosis)
    if not named:
        return _unknown(diagnosis)
    together = sum(_chance(diagnosis, name) for name in names)
    kinds = {words_of(one.name).kind for one in named}
    sentences = [_size(diagnosis), _located(diagnosis), _cause(diagnosis, named, names, together)]
    if together >= LIKELY:
        sentences += [f"Estimated: {'; '.join(estimates(one))}." for one in named if one.parameters]
        sentences.append(_consequence(kinds))
        sentences.append(_closure(diagnosis, kinds))
        sentences += [words_of(one.name).do for one in named] if len(names) == 1 else []
    return [*sentences, _next(diagnosis)]


def _none(diagnosis: Diagnosis) -> list[str]:
    gap = diagnosis.gap
    chance = _chance(diagnosis, "none")
    opening = f"The sim agrees with the recording: no effect has to be added (probability {probability(chance)})."
    size = ""
    if gap is not None:
        floor = f"; even the true model would miss by {percent(gap.floor)}" if math.isfinite(gap.floor) else ""
        size = f"Its forecasts {_over(gap)} miss by {percent(gap.before)} of the size of the motion{floor}."
    blind = effects_shown(excitations(diagnosis), "no")
    caveat = f"This recording could not have shown {_listed(blind, 'or')}." if blind else ""
    return [opening, size, caveat, _next(diagnosis) if blind else ""]


def _unknown(diagnosis: Diagnosis) -> list[str]:
    chance = _chance(diagnosis, "unknown")
    sentences = [
        _size(diagnosis),
        _located(diagnosis),
        f"No effect of the catalogue explains it (probability {probability(chance)}).",
    ]
    known = [one for one in diagnosis.candidates if one.name not in ("none", "unknown")]
    if known:
        closes = known[0].closure
        much = f" would close {percent(closes.value)} of it but" if closes and closes.value is not None else ""
        sentences.append(
            f"The nearest, {place(known[0])},{much} leaves more than noise behind; it should not be taken "
            "for the cause, since a wrong effect often closes much of a gap."
        )
    return [*sentences, WORDS["unknown"].do, _next(diagnosis)]


def _undetermined(diagnosis: Diagnosis) -> list[str]:
    why = reasons(diagnosis)[0].rstrip(".")
    sentences = [f"This recording cannot decide what is wrong with the sim, if anything: {why}."]
    if diagnosis.gap is not None:
        sentences.append(_size(diagnosis))
    first = [one for one in diagnosis.candidates if one.name not in ("none", "unknown")][:3]
    if first and first[0].probability > 0.0:
        told = [f"{place(one)} ({probability(one.probability)})" for one in first]
        sentences.append(f"Most probable so far: {_joined(told, 'and')}; none of them is established.")
    return [*sentences, _next(diagnosis)]


def _size(diagnosis: Diagnosis) -> str:
    gap = diagnosis.gap
    if gap is None:
        return ""
    floor = f"; noise alone would leave {percent(gap.floor)}" if math.isfinite(gap.floor) else ""
    return (
        f"The sim's forecasts {_over(gap)} miss the measurement by {percent(gap.before)} of the size of "
        f"the motion{floor}."
    )


def _over(gap: Gap) -> str:
    known = math.isfinite(gap.horizon_s)
    return f"over one natural period ({number(gap.horizon_s)} s)" if known else "over one natural period"


def _located(diagnosis: Diagnosis) -> str:
    where = diagnosis.where
    level = located(where, "level")
    if level not in PLACES:
        return ""
    text = PLACES[level]
    shares = located(where, "coordinates") or {}
    main = main_coordinate(where)
    if main is not None and len(shares) > 1:
        text += f", mostly in {main} ({percent(shares[main])})"
    components = {k: v for k, v in (located(where, "components") or {}).items() if k in ACTS_LIKE}
    if level == "dynamics" and components and max(components.values()) >= 0.4:
        best = max(components, key=lambda name: components[name])
        text += f", and acts like {ACTS_LIKE[best]} ({percent(components[best])})"
    return text + "."


def _cause(diagnosis: Diagnosis, named: list[Candidate], names: list[str], together: float) -> str:
    verb = "The cause is" if together >= SURE else "The likely cause is"
    if together < LIKELY:
        first = [one for one in diagnosis.candidates if one.name != "none"][:3]
        told = [f"{place(one)} ({probability(one.probability)})" for one in first]
        return f"Its cause is undecided; most probable are {_joined(told, 'and')}."
    if len(named) > 1:
        first = probability(together)
        told = [f"{words_of(one.name).title}{_at(one)}" for one in named]
        what = " ".join(words_of(one.name).what for one in named)
        return f"{len(named)} effects act together: {_joined(told, 'and')} (the first with probability {first}). {what}"
    if len(names) > 1:
        told = [f"{words_of(name).title} ({probability(_chance(diagnosis, name))})" for name in names]
        return (
            f"{verb} one of these, which this recording cannot tell apart: {_joined(told, 'or')}; together "
            f"they have probability {probability(together)}."
        )
    words = words_of(named[0].name)
    return f"{verb} {words.title}{_at(named[0])} (probability {probability(together)}). {words.what}"


def _at(candidate: Candidate) -> str:
    at = f" at {candidate.coordinate}" if candidate.coordinate else ""
    return f"{at} on {candidate.input}" if candidate.input else at


def _consequence(kinds: set[str]) -> str:
    if kinds == {"parameter"}:
        return "This is a parameter change: the sim lacks no physics, and a refit suffices."
    if kinds == {"observation"}:
        return "The fault is in camera or timing; the mechanism moves as the sim says."
    if kinds == {"outside"}:
        return "The mechanism itself is as the sim says."
    return ""


def _closure(diagnosis: Diagnosis, kinds: set[str]) -> str:
    gap = diagnosis.gap
    if gap is None:
        return ""
    if gap.closure.value is None:
        return "How far it closes the gap cannot be told: the gap hardly exceeds what noise leaves."
    interval = ""
    if gap.closure.low is not None and gap.closure.high is not None:
        interval = f" (95 % interval {percent(gap.closure.low)} to {percent(gap.closure.high)})"
    act = "Allowing for it" if kinds == {"observation"} else "Adding it to the sim"
    text = (
        f"{act} shrinks the miss from {percent(gap.before)} to {percent(gap.after)}, which is "
        f"{percent(gap.closure.value)} of what can be removed{interval}"
    )
    shares = shares_of_closure(gap)
    text += f"; refitting alone removes {percent(shares[0])}." if shares else "."
    if gap.floor > 0.0 and gap.after > LEFT_OVER * gap.floor:
        times = number(gap.after / gap.floor)
        text += f" What remains is {times} times what noise leaves, so that something else is missing too."
    return text


def _next(diagnosis: Diagnosis) -> str:
    if not diagnosis.excitation:
        return ""
    advice = diagnosis.excitation[0].rstrip(".")
    return f"To know more, record this next: {advice}."


def _chance(diagnosis: Diagnosis, name: str) -> float:
    return sum(one.probability for one in diagnosis.candidates if one.name == name)


def _bounds(bound: object, value: object) -> list[float | None]:
    found: list[float | None] = list(values(bound))
    return found if len(found) == len(values(value)) else [None] * len(values(value))


def _listed(names: list[str], word: str) -> str:
    more = len(names) - NAMED
    told = [short_title(name) for name in names[:NAMED]]
    return _joined([*told, f"{more} others"] if more > 0 else told, word)


def _joined(texts: list[str], word: str) -> str:
    if len(texts) < 2:
        return "".join(texts)
    return f"{', '.join(texts[:-1])} {word} {texts[-1]}"


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
