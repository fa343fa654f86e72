"""Two decoders at equal terms: their table, and the velocities of their primitives."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from lagsplat.report.common.formatting import (
    escape_latex,
    format_cells,
    format_grouped_table,
    format_latex_number,
    join_distinct,
)
from lagsplat.report.common.published_values import RECORDING
from lagsplat.report.common.style import PAGE_IN, new_figure, paper_style
from lagsplat.report.common.table_rows import build_table

DECODER_TITLES = {"conditioned": "Conditioned on the state (LaGSplat)", "deformed": "Deformation field"}
DEFORMATION_MEASURES = {
    "l1": "L1",
    "dissimilarity": "1 - SSIM",
    "roughness": "Roughness, px/s",
    "speed": "Own speed, px/s",
    "painted_still": "Painted on background, px/s",
    "painted_moving": "Painted elsewhere, px/s",
    "parameters": "Parameters",
    "wall_s": "Training, s",
}
DEFORMATION_COLUMNS = (
    *("system", "decoder", *DEFORMATION_MEASURES),
    *("n_gaussians", "steps", "recording", "profile"),
)
# Appendix "Deformation-Field Decoder at Equal Budget": 15 000 primitives, on its film of the rocker.
PAPER_DECODERS: dict[str, dict[str, dict[str, float]]] = {
    "rainbow_rocker": {
        "conditioned": {"l1": 0.0142, "dissimilarity": 0.063, "roughness": 1.4, "parameters": 195e3},
        "deformed": {"l1": 0.0157, "dissimilarity": 0.076, "roughness": 6.9, "parameters": 9.8e6},
    }
}
PAPER_PRIMITIVES = 15000


def build_deformation_table(
    runs: Sequence[Mapping[str, Any]], results: Sequence[Mapping[str, Mapping[str, Any]]]
) -> pd.DataFrame:
    """Build a row for each decoder of each system, and the paper's own on its film.

    ``results`` holds, for each run, the measures of `lagsplat.evaluate.velocity_field` by decoder, with
    ``wall_s`` and ``steps`` of the training.
    """
    rows: list[dict[str, Any]] = []
    for run, decoders in zip(runs, results, strict=True):
        shared = {key: run[key] for key in ("system", "recording", "profile")}
        rows += [{**shared, "decoder": name, **measures} for name, measures in decoders.items()]
    paper = {"n_gaussians": PAPER_PRIMITIVES, "profile": "the paper's", "recording": RECORDING}
    for system in dict.fromkeys(str(run["system"]) for run in runs):
        decoders = PAPER_DECODERS.get(system, {})
        rows += [{"system": system, "decoder": name, **own, **paper} for name, own in decoders.items()]
    table = build_table(rows, DEFORMATION_COLUMNS)
    return table.sort_values("system", kind="stable").reset_index(drop=True)


def format_deformation_latex(table: pd.DataFrame, *, titles: Mapping[str, str]) -> str:
    """Format the table of `build_deformation_table` in LaTeX; ``titles`` gives the name of each system."""

    def format_row(row: Mapping[Any, Any]) -> str:
        name = DECODER_TITLES.get(str(row["decoder"]), str(row["decoder"]))
        values = (format_latex_number(row[measure]) for measure in DEFORMATION_MEASURES)
        return format_cells(escape_latex(name), *values, escape_latex(str(row["recording"])))

    ours = table[table["profile"] != "the paper's"]
    head = format_cells("Decoder", *map(escape_latex, DEFORMATION_MEASURES.values()), "Recording")
    return format_grouped_table(
        table,
        by="system",
        titles=titles,
        row=format_row,
        head=[head],
        alignment="l" + "c" * len(DEFORMATION_MEASURES) + "l",
        caption=(
            f"Two decoders of the same frozen latents with {join_distinct(ours['n_gaussians'])} Gaussians "
            f"each, the same losses, step sizes and {join_distinct(ours['steps'])} steps; profile "
            f"{join_distinct(ours['profile'])}. L1 and SSIM are over the frames that were fitted. Roughness "
            "is how far a primitive's velocity differs from its neighbours', the median over visible "
            "primitives at the frame of the fastest motion; painted means drawn with the primitives' own "
            "opacities and shapes. The paper's rows are of its film, with 15000 primitives."
        ),
        label="tab:deformation",
    )


def draw_jacobian_field(
    decoders: Mapping[str, Mapping[str, np.ndarray]], measures: Mapping[str, Mapping[str, Any]], *, title: str
) -> Figure:
    """Picture and painted speeds of each decoder at the same state, both speeds on one colour scale.

    ``decoders`` maps the name of each to its maps ``picture`` (3,H,W) in [0, 1] and ``speed`` (H,W) [px/s].

    Source: paper, the figure of the same motion read off the two decoders.
    """
    top = max(float(np.percentile(maps["speed"], 99.5)) for maps in decoders.values())
    with paper_style():
        height, width = next(iter(decoders.values()))["speed"].shape
        side = PAGE_IN / (2 * len(decoders)) * 0.95
        figure = new_figure(PAGE_IN, side * height / width + 0.75, title=title)
        axes = figure.subplots(1, 2 * len(decoders))
        for index, (name, maps) in enumerate(decoders.items()):
            axes[2 * index].imshow(np.clip(np.moveaxis(maps["picture"], 0, 2), 0.0, 1.0))
            axes[2 * index].set_title(DECODER_TITLES[name].partition(" (")[0], loc="left")
            image = axes[2 * index + 1].imshow(maps["speed"], cmap="magma", vmin=0.0, vmax=max(top, 1e-9))
            rough = measures[name]["roughness"]
            text = "no primitive is visible" if rough is None else f"neighbours differ by {rough:.3g} px/s"
            axes[2 * index + 1].set_title(text, loc="left")
        for axis in axes:
            axis.set(xticks=[], yticks=[])
        figure.colorbar(image, ax=list(axes), label="speed of the primitives [px/s]", shrink=0.9, pad=0.01)
    return figure
