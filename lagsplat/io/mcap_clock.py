"""Instants of messages on the clock that was asked for, checked to run forwards.

A clock that steps backwards is refused, for no one can tell which side of the step is right. Messages with
the instant of the one before are dropped, with a warning.
"""

import warnings
from dataclasses import dataclass, field

import numpy as np
from jaxtyping import Bool, Int64


@dataclass
class Stamps:
    """Both clocks of the messages of one topic [ns]; ``header_ns`` is None where a message has no stamp."""

    topic: str
    header_ns: list[int | None] = field(default_factory=list)
    log_ns: list[int] = field(default_factory=list)

    def add(self, header_ns: int | None, log_ns: int) -> None:
        """Append one message."""
        self.header_ns.append(header_ns)
        self.log_ns.append(log_ns)

    def chosen(self, clock: str) -> list[int | None]:
        """The instants on the clock ``header`` or ``log``."""
        return self.header_ns if clock == "header" else list(self.log_ns)

    def upto(self, count: int) -> "Stamps":
        """The first ``count`` messages."""
        return Stamps(self.topic, self.header_ns[:count], self.log_ns[:count])


def instants(
    stamps: Stamps, *, clock: str, source: str
) -> tuple[Int64[np.ndarray, " K"], Bool[np.ndarray, " N"]]:
    """The instants [ns] that strictly increase, and which messages they belong to.

    Raises:
        ValueError: a message has no stamp, all stamps are the same, or a stamp lies before the one before;
        the message names both and says whether the other clock runs forwards.
    """
    chosen = stamps.chosen(clock)
    where = f"{source}: topic {stamps.topic}"
    if None in chosen:
        raise ValueError(
            f"{where}: message {chosen.index(None)} carries no stamp; use recording.mcap.clock=log"
        )
    times = np.array(chosen, np.int64)
    steps = np.diff(times)
    if len(times) > 1 and not steps.any():
        raise ValueError(
            f"{where}: all {len(times)} messages carry the {clock} stamp {times[0]} ns, so it was never set"
            + _other(stamps, clock)
        )
    back = np.flatnonzero(steps < 0)
    if back.size:
        i = int(back[0])
        raise ValueError(
            f"{where}: the {clock} clock jumps back from {times[i] / 1e9:.6f} s (message {i}) to "
            f"{times[i + 1] / 1e9:.6f} s (message {i + 1}), {back.size} such steps{_other(stamps, clock)}"
        )
    fresh = np.concatenate([np.ones(min(1, len(times)), bool), steps > 0])
    if not fresh.all():
        warnings.warn(
            f"{where}: {(~fresh).sum()} of {len(times)} messages carry the stamp of the one before and "
            "are dropped",
            stacklevel=3,
        )
    return times[fresh], fresh


def _other(stamps: Stamps, clock: str) -> str:
    name = "log" if clock == "header" else "header"
    other = stamps.chosen(name)
    if None not in other and (np.diff(np.array(other, np.int64)) > 0).all():
        return f". The {name} clock runs forwards: use recording.mcap.clock={name}"
    return f". The {name} clock is no better; cut the file there, for instance with `mcap filter`"
