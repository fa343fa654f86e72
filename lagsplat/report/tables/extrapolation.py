"""The table of extrapolation: every measure of every model over its seeds, and the same in LaTeX."""

from collections.abc import Mapping, Sequence
from typing import Any, NamedTuple

import numpy as np
import pandas as pd

from lagsplat.report.common.formatting import (
    escape_latex,
    format_block_title,
    format_cells,
    format_latex_number,
    format_latex_table,
    join_distinct,
    rescale,
)
from lagsplat.report.common.published_values import RECORDING
from lagsplat.report.common.table_rows import take_median

OURS, FORECASTER, FREE = "LaGSplat", "key-point forecaster (re-implementation)", "neural ODE"
AUTHORS = "GaussianPrediction (the authors' code)"
PAPER_TITLES = {"LaGSplat": "LaGSplat (paper)", "GaussianPrediction": "GaussianPrediction (paper)"}
N_IMAGE_MEASURES = 4  # the first of `MEASURES`; the others are of physics
USUAL_MODELS = (OURS, FORECASTER, FREE, AUTHORS)
SHORT_TITLES = {
    OURS: "LaGSplat",
    FORECASTER: "Key points",
    FREE: "Neural ODE",
    AUTHORS: "Authors' code",
    PAPER_TITLES["LaGSplat"]: "LaGSplat",
    PAPER_TITLES["GaussianPrediction"]: "GaussianPred.",
}
EXTRAPOLATION_COLUMNS = (
    *("system", "model", "measure", "value", "low", "high", "n_seeds", "n_measured", "sigma", "note"),
    *("recording", "profile"),
)


class ExtrapolationMeasure(NamedTuple):
    """One measure: its name, its title, its keys in a result, and the factor to its printed unit."""

    name: str
    title: str
    keys: tuple[str, ...]
    scale: float = 1.0

    def read(self, result: Mapping[str, Any]) -> float | None:
        """The value in a result of the extrapolation, errors without their sign; None where there is none."""
        if self.name == "energy_left":
            return _read_energy_left(result)
        value: Any = result
        for key in self.keys:
            value = value[key]
        return value if self.keys[0] != "physics" or value is None else abs(value)


class ModelResults(NamedTuple):
    """The results of one model on one system, seed by seed."""

    system: str
    model: str
    recording: str
    profile: str
    results: list[dict[str, Any]]


def _read_energy_left(result: Mapping[str, Any]) -> float | None:
    """Mean energy of the last look over that of the first natural period past the training frames."""
    first, last = result["looks"][0]["energy"], result["looks"][-1]["energy"]
    if first is None or last is None or result["reason"]:
        return None
    early = float(np.mean(first[: max(4, len(first) // 8)]))
    return float(np.mean(last)) / early if early > 0 else None


MEASURES = (
    ExtrapolationMeasure("psnr_mean", "Mean on held-out frames", ("psnr", "mean")),
    ExtrapolationMeasure("psnr_first", "First predicted frame", ("psnr", "first")),
    ExtrapolationMeasure("psnr_last", "Last predicted frame", ("psnr", "last")),
    ExtrapolationMeasure("psnr_aligned", "Mean, phase taken out", ("aligned", "mean")),
    ExtrapolationMeasure("frequency_error", "Frequency error (%)", ("physics", "frequency_error"), 100.0),
    ExtrapolationMeasure("rate_error", "Dissipation error (%)", ("physics", "rate_error"), 100.0),
    ExtrapolationMeasure("left_shown", "Amplitude left where the figure ends (%)", ("left_shown",), 100.0),
    ExtrapolationMeasure("left", "Amplitude left at the horizon (%)", ("left",), 100.0),
    ExtrapolationMeasure("energy_left", "Energy left at the horizon (%)", ("looks",), 100.0),
    ExtrapolationMeasure("inside", "Frames in the encoder's range (%)", ("range", "inside"), 100.0),
)
FLOOR = ExtrapolationMeasure("floor", "Autoencoder floor on these frames", ("floor", "mean"))

# Table "Extrapolation past the training window"; the amplitudes where the figure ends from the text.
PAPER_MEASURES = (
    *("psnr_mean", "psnr_first", "psnr_last"),
    *("frequency_error", "rate_error", "left_shown", "left", "floor"),
)
PAPER_EXTRAPOLATION: dict[str, dict[str, tuple[float | None, ...]]] = {
    "rainbow_rocker": {
        "LaGSplat": (25.88, 27.28, 23.53, 0.012, 0.29, None, 0.0, 31.79),
        "GaussianPrediction": (27.86, 31.61, 23.63, 0.009, 0.60, 0.55, 0.53, None),
    }
}


def group_models(
    runs: Sequence[Mapping[str, Any]], others: Sequence[Mapping[str, Any]], results: Sequence[dict[str, Any]]
) -> list[ModelResults]:
    """Group the results by system and model; ``results`` are of the runs, then of the others."""
    groups: dict[tuple[str, str, str, str], list[dict[str, Any]]] = {}
    for run, result in zip([*runs, *others], results, strict=True):
        key = (str(run["system"]), name_model(run), str(run["recording"]), str(run["profile"]))
        groups.setdefault(key, []).append(result)
    return [ModelResults(*key, members) for key, members in groups.items()]


def name_model(run: Mapping[str, Any]) -> str:
    """Name a run, or the model beside it, as tables do; a variant's file is named with it."""
    if "kind" not in run:
        return OURS
    name = {"ode": FREE, "forecaster": FORECASTER, "authors": AUTHORS}[run["kind"]]
    usual = "keypoints" if run["kind"] == "forecaster" else "default"
    return name if run["model"] == usual else f"{name}, {run['model']}"


def build_extrapolation_table(models: Sequence[ModelResults]) -> pd.DataFrame:
    """Build a row for every system, model and measure, the paper's own beside them.

    Values are plain numbers, no per cent. ``value`` is the median over the ``n_measured`` seeds in which the
    measure exists, ``low`` and ``high`` their range where they differ, ``sigma`` the median of the
    estimator's own uncertainty. ``note`` says why a seed has none: it diverged, it left the range of the
    encoder, nothing oscillated.

    Raises:
        ValueError: nothing was measured.
    """
    if not models:
        raise ValueError("the table of extrapolation would be empty; choose systems with extrapolated=[...]")
    systems = list(dict.fromkeys(model.system for model in models))
    rows = [_build_row(model, measure) for model in models for measure in (*MEASURES, FLOOR)]
    rows += [row for system in systems for row in _list_paper_rows(system)]
    frame = pd.DataFrame(rows, columns=list(EXTRAPOLATION_COLUMNS), dtype=object)
    order = frame["system"].map(systems.index).argsort(kind="stable")
    return frame.iloc[order].reset_index(drop=True)


def _build_row(model: ModelResults, measure: ExtrapolationMeasure) -> dict[str, Any]:
    values = [measure.read(result) for result in model.results]
    known = [value for value in values if value is not None and np.isfinite(value)]
    several = len(set(known)) > 1
    reasons = {
        "the rollout diverged" if result["diverged"] else str(result["reason"] or result["physics"]["reason"])
        for result, value in zip(model.results, values, strict=True)
        if value is None
    }
    return {
        "system": model.system,
        "model": model.model,
        "measure": measure.name,
        "value": take_median(known),
        "low": min(known) if several else None,
        "high": max(known) if several else None,
        "n_seeds": len(values),
        "n_measured": len(known),
        "sigma": take_median(result["physics"].get(f"{measure.name}_sigma") for result in model.results),
        "note": "; ".join(sorted(reasons - {""})),
        "recording": model.recording,
        "profile": model.profile,
    }


def _list_paper_rows(system: str) -> list[dict[str, Any]]:
    paper = {"n_seeds": 1, "n_measured": 1, "note": "", "recording": RECORDING, "profile": "the paper's"}
    return [
        {"system": system, "model": PAPER_TITLES[name], "measure": measure, "value": value} | paper
        for name, values in PAPER_EXTRAPOLATION.get(system, {}).items()
        for measure, value in zip(PAPER_MEASURES, values, strict=True)
        if value is not None
    ]


def format_extrapolation_latex(table: pd.DataFrame, *, titles: Mapping[str, str]) -> str:
    """Format the table of `build_extrapolation_table` in LaTeX: measures down, models across.

    ``titles`` gives the name of each system. A cell without a number is a dash whose footnote says why.

    Source: paper, Table "Extrapolation past the training window".
    """
    present = list(dict.fromkeys(table["model"]))
    variants = [name for name in present if name not in (*USUAL_MODELS, *PAPER_TITLES.values())]
    models = [*USUAL_MODELS, *variants, *PAPER_TITLES.values()]
    notes: list[str] = []
    if AUTHORS not in present:
        notes.append("The authors' code needs CUDA and was not run on this recording.")
    body: list[str] = []
    for system, block in table.groupby("system", sort=False):
        body.append(format_block_title(titles.get(str(system), str(system)), columns=len(models) + 1))
        for index, measure in enumerate((*MEASURES[:N_IMAGE_MEASURES], FLOOR, *MEASURES[N_IMAGE_MEASURES:])):
            if index == N_IMAGE_MEASURES + 1:
                body.append(r"\noalign{\vskip 2pt}")
            cells = (_format_cell(block, measure, model, notes) for model in models)
            body.append(format_cells(escape_latex(measure.title), *cells))
    head = [
        rf" & \multicolumn{{{len(USUAL_MODELS) + len(variants)}}}{{c}}{{this work}} & "
        rf"\multicolumn{{{len(PAPER_TITLES)}}}{{c}}{{the paper, on its film}} \\",
        format_cells("", *(escape_latex(SHORT_TITLES.get(name, name)) for name in models)),
    ]
    return format_latex_table(
        head=head,
        body=body,
        alignment="l" + "c" * len(models),
        caption=_write_caption(table, notes),
        label="tab:extrapolation",
    )


def _format_cell(block: pd.DataFrame, measure: ExtrapolationMeasure, model: str, notes: list[str]) -> str:
    """A value with its range; why seeds are missing is added to ``notes`` once, and marked in the cell."""
    rows = block[(block["model"] == model) & (block["measure"] == measure.name)].to_dict("records")
    if not rows:
        return r"--$^{1}$" if model == AUTHORS and notes else "--"
    row = rows[0]
    cell = format_latex_number(*(rescale(row.get(key), measure.scale) for key in ("value", "low", "high")))
    if row["n_measured"] == row["n_seeds"]:
        return cell
    note = f"In {row['n_measured']} of {row['n_seeds']} seeds: {row['note']}."
    if note not in notes:
        notes.append(note)
    return cell + rf"$^{{{notes.index(note) + 1}}}$"


def _write_caption(table: pd.DataFrame, notes: list[str]) -> str:
    ours = table[table["recording"] != RECORDING]
    seeds = "; ".join(
        f"{SHORT_TITLES.get(str(name), str(name))} {int(group['n_seeds'].iloc[0])}"
        for name, group in ours.groupby("model", sort=False)
    )
    numbered = " ".join(f"({index + 1}) {note}" for index, note in enumerate(notes))
    return (
        f"Extrapolation past the training frames; {join_distinct(ours['recording'])} recording, profile "
        f"{join_distinct(ours['profile'])}. Medians over seeds with their range ({seeds}). Rendering: PSNR "
        "in dB against the recorded frames; with its phase taken out, each frame is held against the best of "
        "those shown up to two frames earlier or later. Physics is read in the chart of the frozen encoder, "
        "over the whole clip and by one estimator for all: error of the frequency and of the decay rate of "
        "the envelope against the encoded clip. Amplitudes are shares of the clip's first period, at the end "
        "of the figure and of the whole rollout. Key points: a re-implementation of a graph-network "
        "forecaster in two dimensions. Columns of the paper were measured on its film, another recording. "
        f"{numbered}"
    )
