"""The table of learned physics against the truth of the simulated systems."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd

from lagsplat.report.latex import block_title, cells, escape, latex_float, number, scaled
from lagsplat.report.runs import grouped

COLUMNS = ("system", "quantity", "learned", "truth", "error")
CONTEXT = ("encoded", "residual", "recording", "profile", "n_seeds")
SPREAD = ("learned_low", "learned_high")


def truth_table(runs: Sequence[Mapping[str, Any]], metrics: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """A row for each quantity of each simulated system; ``runs`` and ``metrics`` as in `grouped`.

    Over several seeds every number is the median, and ``learned_low`` and ``learned_high`` are the smallest
    and the largest value; ``error`` is the median of the seeds' own. Dynamics other than the default are
    named with the quantity. A recording without truth gives no row.

    Raises:
        ValueError: no recording has a truth.
    """
    rows: list[dict[str, Any]] = []
    for (system, recording, profile, stage1), variants in grouped(runs, metrics).items():
        for stage2, members in variants.items():
            known = [run["truth"]["rows"] for run in members if "truth" in run]
            changed = ", ".join(name for name in (stage1, stage2) if name != "default")
            for quantity in dict.fromkeys(row["quantity"] for seed in known for row in seed):
                same = [row for seed in known for row in seed if row["quantity"] == quantity]
                rows.append(
                    {"system": system, "quantity": quantity + (f" ({changed})" if changed else "")}
                    | _medians(same)
                    | {"recording": recording, "profile": profile, "n_seeds": len(known)}
                )
    if not rows:
        raise ValueError("no run has a truth to compare with: evaluate one of a simulated recording")
    frame = pd.DataFrame(rows, dtype=object)
    spread = [name for name in SPREAD if frame[name].notna().any()]
    return frame.reindex(columns=[*COLUMNS, *CONTEXT, *spread])


def _medians(rows: Sequence[Mapping[str, Any]]) -> dict[str, Any]:
    found: dict[str, Any] = {}
    for name in ("learned", "truth", "error", "encoded", "residual"):
        values = [row[name] for row in rows if row[name] is not None]
        found[name] = float(np.median(values)) if values else None
        if name == "learned":
            several = len(set(values)) > 1
            found["learned_low"] = min(values) if several else None
            found["learned_high"] = max(values) if several else None
    return found


def latex_truth(table: pd.DataFrame, *, titles: Mapping[str, str]) -> str:
    """The same table in LaTeX, block by block; ``titles`` gives the name of each system."""
    body = []
    for system, block in table.groupby("system", sort=False):
        body += [block_title(titles.get(str(system), str(system)), columns=6)]
        body += [
            cells(
                escape(str(row["quantity"])),
                number(row["learned"], row.get("learned_low"), row.get("learned_high")),
                *(number(row[name]) for name in ("truth", "encoded")),
                *(number(scaled(row[name], 100.0)) for name in ("error", "residual")),
            )
            for row in block.to_dict("records")
        ]
    profiles = " and ".join(sorted(set(table["profile"].astype(str))))
    seeds = " or ".join(sorted(set(table["n_seeds"].astype(str))))
    brackets = " Brackets: range over seeds." if "learned_low" in table else ""
    caption = (
        f"Learned physics of the simulated systems against their truth, which no training saw; profile "
        f"{profiles}; medians over seeds ({seeds}).{brackets} A free rollout is compared with the true "
        "motion over the same frames, both measured by the same fit, which also reads the encoded motion; "
        "the linearised law with the eigenvalues of the true equations. Errors are relative; that of an "
        "equilibrium, and the residual of the map by which a latent is read in true coordinates, are "
        "fractions of the motion's rms."
    )
    head = [r"Quantity & Learned & Truth & Encoded & Error (\%) & Map (\%) \\"]
    return latex_float(head=head, body=body, columns="@{}lccccc@{}", caption=caption, label="tab:truth")
