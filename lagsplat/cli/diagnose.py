"""Verbs about the sim-to-real gap: diagnose and apply."""

import sys
from argparse import Namespace
from pathlib import Path

from lagsplat.cli.main import CommandError, split_words
from lagsplat.config.compose import compose


def diagnose(given: Namespace) -> None:
    """Diagnose ``sim`` against ``real``, and write the report."""
    keys, overrides = split_words(given.words, needed=("sim", "real"), allowed=("sim", "real", "out"))
    if other := [word for word in overrides if not word.startswith("diagnose")]:
        raise CommandError(f"diagnose takes sim, real, out and diagnose.key=value, not {other[0]!r}")
    config = compose(*overrides).diagnose
    from lagsplat.pipelines.diagnosis import diagnose_files
    from lagsplat.report.diagnosis.summary import write_summary

    out = Path(keys.get("out", "diagnosis"))
    diagnosis = diagnose_files(keys["sim"], keys["real"], out, config, command=given.text)
    for text in diagnosis.warnings:
        print(f"warning: {text}", file=sys.stderr)
    print(write_summary(diagnosis))
    print(out / "report.html")


def apply(given: Namespace) -> None:
    """Add the effects of a diagnosis to a simulator."""
    allowed = ("diagnosis", "sim", "out", "diagnose.joints", "diagnose.actuators")
    keys, rest = split_words(given.words, needed=("diagnosis", "out"), allowed=allowed)
    if rest:
        raise CommandError(f"apply takes {', '.join(allowed)}, not {rest[0]!r}")
    from lagsplat.pipelines.apply_diagnosis import apply_diagnosis

    names = {name: parse_names(keys.get(f"diagnose.{name}")) for name in ("joints", "actuators")}
    apply_diagnosis(Path(keys["diagnosis"]), keys.get("sim"), out=Path(keys["out"]), **names)
    print(keys["out"])


def parse_names(text: str | None) -> list[str] | None:
    """The names in ``[a,b]`` or ``a,b``; None if nothing is given."""
    if text is None:
        return None
    return [name.strip() for name in text.strip("[]").split(",") if name.strip()]
