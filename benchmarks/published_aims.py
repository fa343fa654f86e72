"""What was measured beside the project's aims, read from the published tables.

What a page shows is written by ``[[[cog show_aims("physics") ]]]`` or ``"forces"``; see
`benchmarks.published_tables`.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd

from benchmarks.drawn_systems import DRIVEN
from benchmarks.published_tables import read_rows, read_titles
from lagsplat.evaluate.truth import AT_REST, LINEARISED, ROLLOUT

ONE = ("pendulum", "rainbow_rocker", "rocking_chair")
TWO = ("hanging_bag", "double_pendulum")
PUSHED = (*ONE, "hanging_bag")  # free systems of which answers to forces are compared with the truth
SPACE = ("rainbow_rocker_3d",)
DRAWN = ("drawn_1", "drawn_2", "drawn_3")
COLUMNS = ["system", "quantity", "error", "worst_seed"]
ARM = ("krauss_2seg",)


class Aim(NamedTuple):
    """The largest error that is aimed at, of a quantity of some systems; a share, or in ``unit``."""

    title: str
    systems: tuple[str, ...]
    quantity: str
    largest: float
    unit: str = ""

    def write(self, value: float, digits: int = 2) -> str:
        """A value of the quantity with its unit; shares in percent."""
        number = value if self.unit else 100.0 * value
        text = f"{number:.0f}" if abs(number) >= 10.0**digits else f"{number:.{digits}g}"
        return f"{text}{self.unit or ' %'}"


def list_physics_aims() -> Iterator[Aim]:
    """The aims for mode 1 of the law at rest and of the free rollout, and for equilibria."""
    for source in (LINEARISED, ROLLOUT):
        yield Aim("free systems", (*ONE, *TWO), f"frequency, {source}", 0.005)
        yield Aim("free systems but one", (*ONE, "hanging_bag"), f"decay rate, {source}", 0.10)
        yield Aim("double pendulum", ("double_pendulum",), f"decay rate, {source}", 0.25)
        yield Aim("arm, one segment", ("krauss_1seg",), f"frequency, {source}", 0.05)
        yield Aim("arm, two segments", ARM, f"frequency, {source}", 0.015)
        yield Aim("both arms", DRIVEN, f"decay rate, {source}", 0.15)
    yield Aim("all", (*ONE, *TWO, *DRIVEN), "equilibrium", 0.1)


def list_force_aims() -> Iterator[Aim]:
    """The aims for answers to forces within the visited range, and for motion that a sudden force begins."""
    for title, systems, largest in (
        ("free systems", PUSHED, (5.0, 0.15, 0.15)),
        ("arm, two segments", ARM, (12.0, 0.30, 0.20)),
        ("rocker in space", SPACE, (7.0, 0.15, 0.15)),
    ):
        yield Aim(title, systems, "direction of the pushed point", largest[0], "°")
        yield Aim(title, systems, "shape over all points", largest[1])
        yield Aim(title, systems, "amplitude after one poke", largest[2])
    yield Aim("all", (*PUSHED, *ARM, *SPACE), "scale that other pokes would have set", 1.33, " times")
    two = ("hanging_bag", *ARM)
    yield Aim("two and four coordinates", two, "first motion, shape", 0.35)
    yield Aim("two and four coordinates", two, "span of the learned mass over the true one", 4.0, " times")


def read_physics(folder: str = "quick_simulated_seven") -> pd.DataFrame:
    """Errors of mode 1, of the law at rest and of the free rollout, and of equilibria."""
    rows = read_rows(f"{folder}/truth", recording="simulated")
    rows = rows[(rows["mode"].fillna(1) == 1) & (rows["state"].fillna(AT_REST) == AT_REST)]
    names = rows["quantity"].where(rows["mode"].isna(), rows["quantity"] + ", " + rows["source"])
    return rows.assign(quantity=names, worst_seed=rows.get("error_high"))[COLUMNS]


def read_answers() -> pd.DataFrame:
    """Errors of the answers to forces, by system and quantity."""
    rows = read_rows("quick_forces/force_truth", recording="simulated")
    rows["scale"] = np.maximum(rows["scale_high"], 1 / rows["scale_low"])
    columns = {
        "direction of the pushed point": ("visited", "direction_deg"),
        "shape over all points": ("visited", "shape"),
        "amplitude after one poke": ("visited", "amplitude"),
        "scale that other pokes would have set": ("visited", "scale"),
        "first motion, shape": ("first motion, learned mass", "shape"),
        "span of the learned mass over the true one": ("span of energies, mass", "span"),
    }
    found = [
        rows[rows["what"] == what].assign(
            quantity=quantity, error=rows[column], worst_seed=rows.get(f"{column}_high")
        )
        for quantity, (what, column) in columns.items()
    ]
    return pd.concat([each[COLUMNS] for each in found])


def find_worst(aim: Aim, errors: pd.DataFrame, column: str = "error") -> tuple[float, str] | None:
    """The largest number of these systems in a column, and whose it is; None where there is none."""
    asked = errors["system"].isin(aim.systems) & (errors["quantity"] == aim.quantity)
    found = errors[asked].dropna(subset=column)
    if found.empty:
        return None
    worst = found.loc[found[column].astype(float).idxmax()]
    return float(worst[column]), str(worst["system"])


KINDS: dict[str, tuple[Callable[[], Iterator[Aim]], Callable[[], pd.DataFrame]]] = {
    "physics": (list_physics_aims, read_physics),
    "forces": (list_force_aims, read_answers),
}


def show_aims(kind: str) -> None:
    """Print the table: quantity, systems, aim, worst median and worst seed with their systems, whether met.

    An aim is met where the medians over seeds of all systems meet it.
    """
    titles = read_titles()
    print("\n| error | systems | aim | worst median | worst seed | met |\n|---|---|:-:|---|---|:-:|")
    for aim, errors in judge_aims(kind):
        numbers = [find_worst(aim, errors, column) for column in ("error", "worst_seed")]
        told = [f"{aim.write(each[0])} ({titles[each[1]]})" if each else "–" for each in numbers]
        met = "yes" if is_met(aim, errors) else "**no**"
        print(f"| {aim.quantity} | {aim.title} | {aim.write(aim.largest, 3)} | {' | '.join(told)} | {met} |")
    print()


def judge_aims(kind: str) -> Iterator[tuple[Aim, pd.DataFrame]]:
    """Each aim of a kind, with the errors that it is about."""
    list_aims, read_errors = KINDS[kind]
    errors = read_errors().reset_index(drop=True)
    for aim in list_aims():
        yield aim, errors


def show_drawn() -> None:
    """Print the table of the aims for systems whose numbers were drawn at random, one seed each.

    Counted is each system of each draw; beside them the systems on whose recordings the method was made.
    """
    print("\n| error | systems | aim | drawn: median, met | developed on: median, met |")
    print("|---|---|:-:|---|---|")
    drawn, known = [read_physics(folder) for folder in DRAWN], [read_physics()]
    for aim in list_physics_aims():
        cells = [_count_met(aim, errors) for errors in (drawn, known)]
        print(f"| {aim.quantity} | {aim.title} | {aim.write(aim.largest, 3)} | {' | '.join(cells)} |")
    print()


def _count_met(aim: Aim, folders: list[pd.DataFrame]) -> str:
    """The median error, and how many systems of these folders meet an aim; what was not found meets none."""
    worst = [find_worst(aim._replace(systems=(name,)), errors) for errors in folders for name in aim.systems]
    errors = [each[0] if each else np.inf for each in worst]
    return f"{aim.write(float(np.median(errors)))}, {sum(e <= aim.largest for e in errors)} of {len(errors)}"


def is_met(aim: Aim, errors: pd.DataFrame) -> bool:
    """Whether the medians of all systems of an aim meet it."""
    worst = find_worst(aim, errors)
    return worst is not None and worst[0] <= aim.largest
