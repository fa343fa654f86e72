"""The table of extrapolation: every measure of every model over its seeds, and the same for print."""

from collections.abc import Mapping, Sequence
from typing import Any, Literal, NamedTuple

import numpy as np
import pandas as pd

from lagsplat.baselines.config import ODE_TITLES
from lagsplat.report.common.formatting import join_distinct
from lagsplat.report.common.printed_table import (
    Column,
    PrintedTable,
    Row,
    lay_out,
    make_number_column,
    make_text_column,
)
from lagsplat.report.common.published_values import PAPER, RECORDING
from lagsplat.report.common.table_rows import name_block, take_median, tell_of_paper

OURS, FORECASTER, FREE = "LaGSplat", "key-point forecaster (re-implementation)", "neural ODE"
HAMILTONIAN = ODE_TITLES["hamiltonian"]
MEAN_STATE, HELD_STATE, LINEAR_LAW = "mean state", "held state", "linear least squares"
AUTHORS = "GaussianPrediction (the authors' code)"
PAPER_TITLES = {"LaGSplat": "LaGSplat (paper)", "GaussianPrediction": "GaussianPrediction (paper)"}
SHORT_TITLES = {
    OURS: "LaGSplat",
    FORECASTER: "Key points",
    FREE: ODE_TITLES["none"],
    HAMILTONIAN: HAMILTONIAN,
    MEAN_STATE: "Mean state",
    HELD_STATE: "Held state",
    LINEAR_LAW: "Linear least squares",
    AUTHORS: "GaussianPrediction",
    PAPER_TITLES["LaGSplat"]: "LaGSplat",
    PAPER_TITLES["GaussianPrediction"]: "GaussianPrediction",
}
MODEL_NAMES = {
    ("ode", "default"): FREE,
    ("ode", "hamiltonian"): HAMILTONIAN,
    ("forecaster", "keypoints"): FORECASTER,
    ("authors", "default"): AUTHORS,
    ("trivial", "mean"): MEAN_STATE,
    ("trivial", "hold"): HELD_STATE,
    ("trivial", "linear"): LINEAR_LAW,
}
USUAL_MODEL = {"ode": "default", "forecaster": "keypoints", "authors": "default"}
EXTRAPOLATION_COLUMNS = (
    *("system", "model", "measure", "value", "low", "high", "n_seeds", "n_measured", "sigma", "note"),
    *("recording", "profile"),
)


class ExtrapolationMeasure(NamedTuple):
    """One measure: its name, its heading, its keys in a result, and the factor to its printed unit."""

    name: str
    title: str
    below: str
    keys: tuple[str, ...]
    scale: float = 1.0
    best: Literal["lowest", "highest"] | None = None
    is_main: bool = False
    least: float = 0.0
    note: str = ""

    def make_column(self) -> Column:
        """The column of a printed table."""
        return make_number_column(
            *(self.name, self.title, self.below),
            scale=self.scale,
            best=self.best,
            least=self.least,
            note=self.note,
        )

    def read(self, result: Mapping[str, Any]) -> float | None:
        """The value in a result of the extrapolation, errors without sign; None where there is none."""
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


OF_FRAMES = "PSNR: of the held-out frames; phase out: best of the frames shown up to two earlier or later."
OF_CHART = (
    "Errors: of the frequency and of the decay rate of the envelope, in the chart of the frozen encoder."
)
LEFT = "Left: at the horizon, of that in the clip's first period; in figure: where the figure ends."
MEASURES = (
    ExtrapolationMeasure(
        *("psnr_mean", "PSNR (dB)", "mean", ("psnr", "mean")), best="highest", is_main=True, note=OF_FRAMES
    ),
    ExtrapolationMeasure("psnr_first", "PSNR (dB)", "first", ("psnr", "first"), best="highest"),
    ExtrapolationMeasure("psnr_last", "PSNR (dB)", "last", ("psnr", "last"), best="highest"),
    ExtrapolationMeasure(
        *("psnr_aligned", "PSNR (dB)", "phase out", ("aligned", "mean")), best="highest", is_main=True
    ),
    ExtrapolationMeasure(
        *("frequency_error", "Error (%)", "frequency", ("physics", "frequency_error"), 100.0, "lowest"),
        is_main=True,
        note=OF_CHART,
    ),
    ExtrapolationMeasure(
        *("rate_error", "Error (%)", "dissipation", ("physics", "rate_error"), 100.0, "lowest"), is_main=True
    ),
    ExtrapolationMeasure("left_shown", "Amplitude", "in figure (%)", ("left_shown",), 100.0, least=0.01),
    ExtrapolationMeasure("left", "Amplitude", "left (%)", ("left",), 100.0, None, True, 0.01, LEFT),
    ExtrapolationMeasure("energy_left", "Energy", "left (%)", ("looks",), 100.0, least=0.01, note=LEFT),
    ExtrapolationMeasure(
        *("inside", "In range", "(%)", ("range", "inside"), 100.0),
        note="In range: frames that the encoder places among those it was trained on.",
    ),
)
FLOOR = ExtrapolationMeasure("floor", "PSNR (dB)", "autoencoder", ("floor", "mean"))

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
    kind, model = str(run["kind"]), str(run["model"])
    known = MODEL_NAMES.get((kind, model))
    return known or f"{MODEL_NAMES[kind, USUAL_MODEL[kind]]}, {model}"


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
    paper = {"n_seeds": 1, "n_measured": 1, "note": "", **PAPER}
    return [
        {"system": system, "model": PAPER_TITLES[name], "measure": measure, "value": value} | paper
        for name, values in PAPER_EXTRAPOLATION.get(system, {}).items()
        for measure, value in zip(PAPER_MEASURES, values, strict=True)
        if value is not None
    ]


def lay_out_extrapolation(table: pd.DataFrame, *, titles: Mapping[str, str]) -> list[PrintedTable]:
    """Lay out the table of `build_extrapolation_table`, models down: what readers look for, and the rest.

    ``titles`` gives the name of each system. A mark leads to the note on why seeds are missing.

    Source: paper, Table "Extrapolation past the training window".
    """
    reasons: list[str] = []
    frame = _spread_measures(table, reasons)
    ours = table[table["recording"] != RECORDING]
    settings = f"{join_distinct(ours['recording'])} recording, profile {join_distinct(ours['profile'])}"
    notes = [f"({number}) {reason}" for number, reason in enumerate(reasons, start=1)]
    if AUTHORS not in set(table["model"]):
        notes.append("The authors' code of GaussianPrediction needs CUDA and was not run.")
    model = make_text_column(
        "Model",
        _shorten_model,
        wrap_em=9,
        note="Key points: our two-dimensional re-implementation of a graph-network forecaster.",
    )
    lead = "Extrapolation past the training frames"
    paper = tell_of_paper(table, " The paper's: on its film.")
    return [
        lay_out(
            frame,
            [model, *(one.make_column() for one in (*MEASURES, FLOOR) if one.is_main is is_main)],
            label=label,
            lead=f"{lead}{more}.",
            caption=f"Ours: {settings}; medians over seeds, with their range.{paper}",
            block=lambda row: name_block(row, titles),
            notes=notes,
        )
        for is_main, label, more in (
            (True, "tab:extrapolation", ""),
            (False, "tab:extrapolation-rest", ": further measures"),
        )
    ]


def _shorten_model(row: Row) -> str:
    """The short title of a model, with the variant that is named behind it."""
    name, comma, variant = row["model"].partition(", ")
    return f"{SHORT_TITLES.get(name, name)}{comma}{variant}"


def _spread_measures(table: pd.DataFrame, reasons: list[str]) -> pd.DataFrame:
    """A row for each model of each recording; why a seed is missing is marked and added to ``reasons``."""
    rows: dict[tuple[str, ...], dict[str, Any]] = {}
    for found in table.to_dict("records"):
        key = tuple(str(found[name]) for name in ("system", "recording", "model"))
        row = rows.setdefault(key, {name: found[name] for name in ("system", "recording", "model")})
        name = found["measure"]
        row |= {name: found["value"], f"{name}_low": found["low"], f"{name}_high": found["high"]}
        if found["n_measured"] < found["n_seeds"]:
            reason = f"In {found['n_measured']} of {found['n_seeds']} seeds: {found['note']}."
            if reason not in reasons:
                reasons.append(reason)
            row[f"{name}_mark"] = str(reasons.index(reason) + 1)
    return pd.DataFrame(list(rows.values()), dtype=object)
