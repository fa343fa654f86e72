"""The benchmark table, for reading by machine and by LaTeX."""

from collections.abc import Mapping, Sequence
from typing import Any

import pandas as pd

from lagsplat.evaluate.aggregate import aggregate
from lagsplat.report.published import paper_rows
from lagsplat.report.runs import grouped

MEASURED = ("ae_floor", "mse_half_second", "frequency_error", "latent_nrmse", "image_ratio")
COLUMNS = (
    "robot",
    "method",
    "dynamics",
    "d",
    *MEASURED,
    "external_force",
    "diverged",
    "recording",
    "profile",
    "n_seeds",
)
SCALES = {"ae_floor": 1e5, "mse_half_second": 1e3, "frequency_error": 1e2}
SPECIAL = {"\\": r"\textbackslash{}", "~": r"\textasciitilde{}", "^": r"\textasciicircum{}"} | {
    letter: "\\" + letter for letter in "_%&#${}"
}
# With booktabs loaded these three do nothing; without it the table still compiles.
RULES = (
    r"\providecommand{\toprule}{\hline}"
    r"\providecommand{\midrule}{\hline}"
    r"\providecommand{\bottomrule}{\hline}"
)


def table_row(
    aggregated: Mapping[str, Any], *, robot: str, method: str, recording: str, profile: str
) -> dict[str, Any]:
    """One row of the table from the scores of `lagsplat.evaluate.aggregate.aggregate`.

    ``robot`` is the system's name, ``recording`` says what was measured on (``simulated``, ``filmed``).
    Ratios and errors are plain numbers (a frequency error of 0.05 is five per cent); a score without spread
    has no ``_low`` and ``_high``.

    Raises:
        ValueError: the recording's own origin is another one than ``recording`` says.
    """
    origin = aggregated["recording"]["origin"]
    if origin is not None and not recording.startswith(origin):
        raise ValueError(
            f"{robot}: the scores are of a {origin} recording and the row would say {recording!r}; "
            "gather the metrics of that recording's own folder"
        )
    scores = aggregated["scores"]
    row: dict[str, Any] = {
        "robot": robot,
        "method": method,
        "dynamics": aggregated["dynamics"],
        "d": aggregated["d"],
        **{name: scores[name]["median"] for name in MEASURED},
        "external_force": aggregated["external_force"],
        "diverged": aggregated["diverged"],
        "recording": recording,
        "profile": profile,
        "n_seeds": aggregated["n_seeds"],
        "rollouts": aggregated["rollouts"],
        "spread": aggregated["spread"],
        "source": aggregated["recording"].get("source"),
    }
    for name in MEASURED:
        row[f"{name}_low"], row[f"{name}_high"] = scores[name]["low"], scores[name]["high"]
    return row


def benchmark_table(rows: Sequence[Mapping[str, Any]]) -> pd.DataFrame:
    """Our rows and the paper's own beside them, robot by robot.

    The columns are `COLUMNS`, then ``_low`` and ``_high`` of each metric that has a spread anywhere.

    Raises:
        ValueError: no row.
    """
    if not rows:
        raise ValueError("a table needs at least one row; evaluate a run first")
    robots = list(dict.fromkeys(row["robot"] for row in rows))
    everything = pd.DataFrame([*rows, *paper_rows(set(robots))], dtype=object)
    everything = everything.sort_values("robot", key=lambda names: names.map(robots.index), kind="stable")
    bounds = [f"{name}_{end}" for name in MEASURED for end in ("low", "high")]
    kept = [name for name in bounds if name in everything and everything[name].notna().any()]
    return everything.reindex(columns=[*COLUMNS, *kept]).reset_index(drop=True)


def latex_table(rows: Sequence[Mapping[str, Any]], *, titles: Mapping[str, str]) -> str:
    """The same table in LaTeX, for ``\\input`` in any article (booktabs is used where it is loaded).

    ``titles`` gives the heading of each robot's block. The caption names the recordings, the profiles and
    what the brackets are.
    """
    frame = benchmark_table(rows)
    rollouts = {(row["robot"], row["method"], row["recording"]): row["rollouts"] for row in rows}
    body: list[str] = []
    for robot, block in frame.groupby("robot", sort=False):
        title = _escape(titles.get(str(robot), str(robot)))
        body += [rf"\midrule \multicolumn{{11}}{{@{{}}l}}{{\emph{{{title}}}}} \\"]
        body += [_line(row, rollouts) for row in block.to_dict("records")]
    head = (
        r"Method & Dynamics & $d$ & AE floor & MSE 0.5\,s & $\varepsilon_{\mathrm{freq}}$ & NRMSE & "
        r"Image & Ext. & Diverged & Recording \\"
        "\n"
        r" & & & $(10^{-5})$ & $(10^{-3})$ & (\%) & latent & $/$ floor & force & rollouts & \\"
    )
    return "\n".join(
        [
            RULES,
            r"\begin{table*}",
            r"\centering\footnotesize\setlength{\tabcolsep}{3pt}",
            rf"\caption{{{_caption(rows, frame)}}}",
            r"\label{tab:krauss}",
            r"\begin{tabular}{@{}llccccccccl@{}}",
            r"\toprule",
            head,
            *body,
            r"\bottomrule",
            r"\end{tabular}",
            r"\end{table*}",
            "",
        ]
    )


def _caption(rows: Sequence[Mapping[str, Any]], frame: pd.DataFrame) -> str:
    recordings = " and ".join(sorted({_named(row) for row in rows}))
    profiles = " and ".join(sorted({str(row["profile"]) for row in rows}))
    spreads = "; ".join(sorted({f"{row['spread']} ({row['n_seeds']})" for row in rows}))
    text = (
        f"Half-second forecasts, free oscillation and two-period forecasts on the held-out part of the "
        f"{recordings}, profile {profiles}. Values and brackets: {spreads}. A rollout that "
        "diverges stays in every mean, scored no better than the mean prediction. Rows marked as the "
        "paper's are its own numbers, measured on its filmed recordings, and are not comparable with a "
        "simulated one."
    )
    return _escape(text)


def _named(row: Mapping[str, Any]) -> str:
    """A recording as the caption calls it: a file that a user gave need not be what a camera saw."""
    source = row.get("source")
    return f"{row['recording']} recording" + (f" ({source})" if source else "")


def _line(row: Mapping[Any, Any], rollouts: Mapping[tuple[str, str, str], int]) -> str:
    total = rollouts.get((row["robot"], row["method"], row["recording"]))
    diverged = "--" if pd.isna(row["diverged"]) or total is None else f"{row['diverged']}/{total}"
    cells = [
        _escape(str(row["method"])),
        _escape(str(row["dynamics"])),
        str(row["d"]),
        *(_number(row, name) for name in MEASURED),
        _escape(str(row["external_force"])),
        diverged,
        _escape(str(row["recording"])),
    ]
    return " & ".join(cells) + r" \\"


def _number(row: Mapping[Any, Any], name: str) -> str:
    """Three digits and, smaller, the spread; a dash where nothing was measured."""
    scale = SCALES.get(name, 1.0)
    value, low, high = (row.get(key) for key in (name, f"{name}_low", f"{name}_high"))
    if value is None or pd.isna(value):
        return "--"
    text = _digits(scale * value)
    if low is None or high is None or pd.isna(low) or pd.isna(high):
        return f"${text}$"
    return rf"${text}\,{{\scriptstyle[{_digits(scale * low)},\,{_digits(scale * high)}]}}$"


def _digits(value: float) -> str:
    """Three significant digits in plain notation, so that columns can be compared by eye."""
    text = f"{value:.3g}"
    return f"{value:.0f}" if "e+" in text else f"{value:.6f}".rstrip("0") if "e" in text else text


def _escape(text: str) -> str:
    return "".join(SPECIAL.get(letter, letter) for letter in text)


def rows_of(runs: Sequence[Mapping[str, Any]], metrics: Sequence[dict[str, Any]]) -> list[dict[str, Any]]:
    """One row for each group of runs that differ by their seeds only, in the order of their first run.

    ``runs`` and ``metrics`` as in `grouped`. Dynamics other than the default are named with the method.
    """
    rows = []
    for (system, recording, profile, stage1), variants in grouped(runs, metrics).items():
        for stage2, members in variants.items():
            changed = [name for name in (stage1, stage2) if name != "default"]
            method = f"LaGSplat ({', '.join(changed)})" if changed else "LaGSplat"
            scores = aggregate(members)
            rows.append(table_row(scores, robot=system, method=method, recording=recording, profile=profile))
    return rows
