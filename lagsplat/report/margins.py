"""What a variant of the dynamics gains over the constant-coefficient one, window by window."""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from lagsplat.evaluate.aggregate import SERIES, paired_margin
from lagsplat.report.runs import grouped

BASELINE = "constant"  # conf/stage2/constant.yaml
COLUMNS = (
    "robot", "dynamics", "baseline", "score", "value", "low", "high", "relative", "decided", "windows",
    "recording", "profile", "n_seeds",
)  # fmt: skip


def margin_table(runs: Sequence[Mapping[str, Any]], metrics: Sequence[dict[str, Any]]) -> pd.DataFrame:
    """A row for each score and each variant that has a constant-coefficient run beside it.

    ``runs`` and ``metrics`` as in `grouped`. ``value`` is how much lower the variant errs, with its bootstrap
    interval over windows, seeds averaged on both sides; ``decided`` says that the interval excludes zero.
    Without a constant-coefficient run the table is empty.
    """
    rows: list[dict[str, Any]] = []
    for (system, recording, profile, _), variants in grouped(runs, metrics).items():
        baseline = variants.pop(BASELINE, [])
        for name, members in variants.items() if baseline else ():
            for score, (block, key) in SERIES.items():
                if not all(key in run[block] for run in [*members, *baseline]):
                    continue  # no natural period, hence nothing was scored over two of them
                margin = paired_margin(members, baseline, score=score)
                rows.append(
                    {"robot": system, "dynamics": name, "baseline": BASELINE, **margin}
                    | {"recording": recording, "profile": profile, "n_seeds": len(members)}
                )
    return pd.DataFrame(rows, columns=list(COLUMNS))
