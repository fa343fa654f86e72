"""Two decoders at equal terms: their table, and the velocities of their primitives."""

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
import pandas as pd
from matplotlib.figure import Figure

from lagsplat.report.common.formatting import join_distinct
from lagsplat.report.common.printed_table import (
    PrintedTable,
    lay_out,
    make_count_column,
    make_number_column,
    make_text_column,
)
from lagsplat.report.common.published_values import PAPER, RECORDING
from lagsplat.report.common.style import PAGE_IN, new_figure, paper_style
from lagsplat.report.common.table_rows import build_table, name_block, tell_of_paper

DECODER_TITLES = {"conditioned": "Conditioned on the state", "deformed": "Deformation field"}
OF_ROUGHNESS = (
    "Roughness: how far a primitive's velocity differs from its neighbours', median over visible primitives "
    "at the frame of the fastest motion."
)
OF_PAINTING = (
    "Painted: speed as drawn with the primitives' own opacities and shapes, on the still background and "
    "where something moves."
)
DEFORMATION_COLUMNS = (
    *("system", "decoder", "l1", "dissimilarity", "roughness", "speed", "painted_still", "painted_moving"),
    *("parameters", "wall_s", "n_gaussians", "steps", "recording", "profile"),
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
    paper = {"n_gaussians": PAPER_PRIMITIVES, **PAPER}
    for system in dict.fromkeys(str(run["system"]) for run in runs):
        decoders = PAPER_DECODERS.get(system, {})
        rows += [{"system": system, "decoder": name, **own, **paper} for name, own in decoders.items()]
    table = build_table(rows, DEFORMATION_COLUMNS)
    return table.sort_values("system", kind="stable").reset_index(drop=True)


def lay_out_deformation(table: pd.DataFrame, *, titles: Mapping[str, str]) -> list[PrintedTable]:
    """Lay out the table of `build_deformation_table`; ``titles`` gives the name of each system."""
    ours = table[table["recording"] != RECORDING]
    gaussians, steps = (join_distinct(ours[key].astype(int)) for key in ("n_gaussians", "steps"))
    columns = [
        make_text_column("Decoder", lambda row: DECODER_TITLES.get(row["decoder"], row["decoder"])),
        make_number_column("l1", "L1", best="lowest", note="L1 and SSIM: over the frames that were fitted."),
        make_number_column("dissimilarity", "1 − SSIM", best="lowest"),
        make_number_column("roughness", "Roughness", "(px/s)", best="lowest", note=OF_ROUGHNESS),
        make_number_column("speed", "Own speed", "(px/s)"),
        make_number_column("painted_still", "still", over="Painted (px/s)", best="lowest", note=OF_PAINTING),
        make_number_column("painted_moving", "moving", over="Painted (px/s)"),
        make_count_column("parameters", "Parameters"),
        make_number_column("wall_s", "Training", "(s)", best="lowest"),
    ]
    return [
        lay_out(
            table,
            columns,
            label="tab:deformation",
            lead="Two decoders of the same frozen latents, at equal terms.",
            caption=(
                f"Ours: {gaussians} Gaussians and {steps} steps, the same losses and step sizes, "
                f"profile {join_distinct(ours['profile'])}."
                + tell_of_paper(table, f" The paper's: {PAPER_PRIMITIVES} Gaussians, on its film.")
            ),
            block=lambda row: name_block(row, titles),
        )
    ]


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
        figure.colorbar(image, ax=list(axes), label="speed of the primitives (px/s)", shrink=0.9, pad=0.01)
    return figure
