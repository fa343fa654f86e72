"""What was named in a diagnosis, and how it is called in a sentence."""

import math

from lagsplat.diagnose.result import Candidate, Diagnosis, Gap
from lagsplat.report.effect_words import short_title, words_of
from lagsplat.report.rounding import spread, values, with_unit

LABELS = {
    ("", "ratio"): "ratio (real to simulated)",
    ("viscous_damping", "rate"): "rate (real minus simulated)",
}


def chosen(diagnosis: Diagnosis) -> list[Candidate]:
    """The effects that were named, in the order of the combination; the most probable where there is none."""
    found = [next(one for one in diagnosis.candidates if one.name == name) for name in diagnosis.combination]
    return found or [one for one in diagnosis.candidates if one.name not in ("none", "unknown")][:1]


def alike(diagnosis: Diagnosis) -> list[str]:
    """The first chosen effect and those this recording cannot tell from it, most probable first."""
    if not chosen(diagnosis):
        return []
    name = chosen(diagnosis)[0].name
    others = {other for group in diagnosis.equivalent if name in group for other in group}
    return sorted({name} | others, key=lambda other: (-chance_of(diagnosis, other), other != name))


def chance_of(diagnosis: Diagnosis, name: str) -> float:
    """Probability of an effect, wherever it acts."""
    return sum(one.probability for one in diagnosis.candidates if one.name == name)


def second_forecast(diagnosis: Diagnosis) -> str:
    """What the augmented forecasts are of: the sim with its effects, or refit where none was chosen."""
    return "sim with effects" if diagnosis.combination else "sim, refit"


def place(candidate: Candidate) -> str:
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
    return (None, several) if candidate.name.startswith("input_") else (several, None)


def titled(candidate: Candidate) -> str:
    """The title with its place, such as "a delay of input u0"."""
    title = words_of(candidate.name).title
    coordinate, source = _spots(candidate)
    inputs = "inputs" if candidate.places else "input"
    if source and "an input" in title:
        title = title.replace("an input", f"{inputs} {source}")
    elif source:
        title += f", on {inputs} {source}"
    return f"{title} at {coordinate}" if coordinate else title


def estimates(candidate: Candidate) -> list[str]:
    """Each parameter with unit and 90 % interval, one text each."""
    told = []
    for name, one in candidate.parameters.items():
        several = isinstance(one.value, list | tuple)
        rows = zip(values(one.value), _bounds(one.low, one.value), _bounds(one.high, one.value), strict=True)
        texts = [spread(*row) for row in rows]
        value = ", ".join(text for text, _, _ in texts) or "–"
        bounds = "" if several or texts[0][1] == "–" else f" (90 % interval {texts[0][1]} to {texts[0][2]})"
        label = LABELS.get((candidate.name, name), LABELS.get(("", name), name.replace("_", " ")))
        told.append(f"{label} {with_unit(value, one.unit)}{bounds}")
    return told


def shares_of_closure(gap: Gap) -> tuple[float, float] | None:
    """What refitting alone takes away and what the effects take, of what lies above the floor."""
    above = gap.before - gap.floor
    if not above > 0.0 or not math.isfinite(gap.refit):
        return None
    return (gap.before - gap.refit) / above, (gap.refit - gap.after) / above


def joined(texts: list[str], word: str) -> str:
    """Texts as a list in a sentence, ``word`` before the last."""
    if len(texts) < 2:
        return "".join(texts)
    return f"{', '.join(texts[:-1])} {word} {texts[-1]}"


def _bounds(bound: object, value: object) -> list[float | None]:
    found: list[float | None] = list(values(bound))
    return found if len(found) == len(values(value)) else [None] * len(values(value))
