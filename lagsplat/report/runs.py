"""Runs that differ by their seeds only, brought together."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple


class Place(NamedTuple):
    """What an autoencoder was trained on, and how; dynamics of one place can be compared."""

    system: str
    recording: str
    profile: str
    stage1: str


def grouped(
    runs: Sequence[Mapping[str, Any]], metrics: Sequence[dict[str, Any]]
) -> dict[Place, dict[str, list[dict[str, Any]]]]:
    """The scores of all seeds, by place and then by dynamics, in the order of their first run.

    ``runs`` are the wildcards of each run's path (profile, recording, system, stage1, ae, stage2, seed), with
    the scores of each in ``metrics``.
    """
    groups: dict[Place, dict[str, list[dict[str, Any]]]] = {}
    for run, scores in zip(runs, metrics, strict=True):
        place = Place(*(str(run[name]) for name in Place._fields))
        groups.setdefault(place, {}).setdefault(str(run["stage2"]), []).append(scores)
    return groups
