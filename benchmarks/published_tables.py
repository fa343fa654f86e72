"""The published tables, laid out for print and for the pages of the documentation.

A page has a table between two comments, ``[[[cog show("quick_baselines/krauss") ]]]`` and ``[[[end]]]``:
``make tables`` writes it again from its file, and a test compares the two.
"""

import sys
from collections.abc import Callable, Iterator
from pathlib import Path

import pandas as pd
import yaml
from cogapp import Cog

from lagsplat.report.common.printed_table import PrintedTable, format_markdown
from lagsplat.report.tables.benchmark import lay_out_benchmark, lay_out_margins
from lagsplat.report.tables.deformation import lay_out_deformation
from lagsplat.report.tables.extrapolation import lay_out_extrapolation
from lagsplat.report.tables.forces import lay_out_forces, lay_out_invariants
from lagsplat.report.tables.gap import lay_out_blind, lay_out_gap
from lagsplat.report.tables.learned_physics import (
    lay_out_guarantee,
    lay_out_mass,
    lay_out_physical,
    lay_out_recipes,
    lay_out_truth,
)

ROOT = Path(__file__).resolve().parents[1]
PUBLISHED = ROOT / "results" / "published"
LAYOUTS: dict[str, Callable[..., list[PrintedTable]]] = {
    "krauss": lay_out_benchmark,
    "deformation": lay_out_deformation,
    "extrapolation": lay_out_extrapolation,
    "force_truth": lay_out_forces,
    "force_invariants": lay_out_invariants,
    "gap": lay_out_gap,
    "gap_blind": lambda table, titles: lay_out_blind(table),
    "guarantee": lay_out_guarantee,
    "margins": lay_out_margins,
    "mass": lay_out_mass,
    "physical": lay_out_physical,
    "recipes": lay_out_recipes,
    "truth": lay_out_truth,
}
"""How each table is laid out, by the name of its file."""


def read_titles() -> dict[str, str]:
    """The names of the systems, as tables have them."""
    files = (ROOT / "conf/system").glob("*.yaml")
    return {path.stem: yaml.safe_load(path.read_text("utf-8"))["system"]["title"] for path in files}


def read_rows(name: str, **equal: object) -> pd.DataFrame:
    """The rows of a published table that have these values.

    Raises:
        ValueError: there is none.
    """
    table = pd.read_csv(PUBLISHED / f"{name}.csv")
    for column, value in equal.items():
        table = table[table[column].isin(value if isinstance(value, tuple) else (value,))]
    if table.empty:
        raise ValueError(f"{name}.csv has no row with {equal}")
    return table


def list_published() -> Iterator[tuple[Path, list[PrintedTable]]]:
    """Every published table of numbers that has a printed form."""
    for path in sorted(PUBLISHED.rglob("*.csv")):
        if path.stem in LAYOUTS:
            yield path, LAYOUTS[path.stem](pd.read_csv(path), titles=read_titles())


def show(name: str, part: int = 0) -> None:
    """Print a part of a published table, such as ``quick_baselines/krauss``, for the page that has it."""
    path = PUBLISHED / f"{name}.csv"
    tables = LAYOUTS[path.stem](pd.read_csv(path), titles=read_titles())
    print(f"\n{format_markdown(tables[part])}\n")


def show_plain(name: str) -> None:
    """Print a published table that has no printed form as it stands, numbers to three digits."""
    table = pd.read_csv(PUBLISHED / f"{name}.csv", keep_default_na=False, na_values=[""])
    print(f"\n| {' | '.join(table.columns)} |\n|{'---|' * len(table.columns)}")
    for row in table.itertuples(index=False):
        cells = [f"{cell:.3g}" if isinstance(cell, float) else str(cell) for cell in row]
        print(f"| {' | '.join('' if cell == 'nan' else cell for cell in cells)} |")
    print()


def list_pages() -> list[Path]:
    """The pages that have a table of a published file."""
    pages = [ROOT / "README.md", PUBLISHED / "README.md", *sorted((ROOT / "docs").rglob("*.md"))]
    return [page for page in pages if "[[[cog" in page.read_text("utf-8")]


def write_pages(*options: str) -> int:
    """Write the tables of all pages again; with ``--check`` compare them. Returns cog's exit status."""
    functions = {
        "tables": "show, show_plain",
        "summary": "show_manifest, show_summary",
        "sealed": "show_sealed",
        "aims": "show_aims, show_drawn",
    }
    prologue = "; ".join(f"from benchmarks.published_{name} import {f}" for name, f in functions.items())
    return int(Cog().main(["cog", "-r", "-P", "-p", prologue, *options, *map(str, list_pages())]) or 0)


if __name__ == "__main__":
    sys.exit(write_pages())
