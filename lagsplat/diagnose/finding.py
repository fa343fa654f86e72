"""What a check of the data found, how grave it is, and what to do about it."""

from collections.abc import Sequence
from dataclasses import dataclass

LEVELS = ("refuse", "undetermined", "warn", "note")
"""``refuse``: nothing can be computed. ``undetermined``: any name would be a guess. ``warn``: the diagnosis
goes on, with less to go by. ``note``: worth knowing."""


@dataclass(frozen=True)
class Finding:
    """One finding. ``check`` names the check; ``source`` the file or the side; ``columns`` whom it concerns.

    ``what`` was found, ``why`` it matters and the ``remedy`` are sentences without a full stop.

    Raises:
        ValueError: an unknown level.
    """

    level: str
    check: str
    source: str
    what: str
    why: str
    remedy: str
    columns: tuple[str, ...] = ()

    def __post_init__(self) -> None:
        if self.level not in LEVELS:
            raise ValueError(f"a finding of level {self.level!r}; the levels are {LEVELS}")

    @property
    def text(self) -> str:
        """The finding in one line, as users read it."""
        return f"{self.source}: {self.what}. {self.why[:1].upper()}{self.why[1:]}; {self.remedy}"


def refuse(findings: Sequence[Finding]) -> None:
    """Stop where a finding says that nothing can be computed.

    Raises:
        ValueError: a finding of level ``refuse``; the message holds all of them.
    """
    grave = [finding.text for finding in findings if finding.level == "refuse"]
    if grave:
        raise ValueError("\n".join(grave))
