"""What was measured beside the project's aims, read from the published tables.

What a page shows is written by ``[[[cog show_aims("physics") ]]]`` or ``"forces"``; see
`benchmarks.published_tables`.
"""

from collections.abc import Callable, Iterator
from typing import NamedTuple

import numpy as np
import pandas as pd

from benchmarks.published_summary import DRIVEN, read_rows
from benchmarks.published_tables import read_titles

ONE = ("pendulum", "rainbow_rocker", "rocking_chair")
TWO = ("hanging_bag", "double_pendulum")
LAW, ROLLOUT = "linearised law", "free rollout"
PUSHED = (*ONE, "hanging_bag")  # free systems of which answers to forces are compared with the truth
SPACE = ("rainbow_rocker_3d",)
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
        return f"{value:.{digits}g}{self.unit}" if self.unit else f"{100 * value:.{digits}g} %"


def list_physics_aims() -> Iterator[Aim]:
    """The aims for mode 1 of the law at rest and of the free rollout, and for equilibria."""
    for source in (LAW, ROLLOUT):
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


def read_physics() -> pd.DataFrame:
    """Errors of the learned physics of the simulated systems, by system and quantity."""
    rows = read_rows("quick_simulated_seven/truth", recording="simulated")
    names = rows["quantity"].str.replace(" of mode 1,", ",").str.replace(r" \[.*\]", "", regex=True)
    return rows.assign(quantity=names)[["system", "quantity", "error"]]


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
        rows[rows["what"] == what].assign(quantity=quantity, error=rows[column])
        for quantity, (what, column) in columns.items()
    ]
    return pd.concat([each[["system", "quantity", "error"]] for each in found])


def find_worst(aim: Aim, errors: pd.DataFrame) -> tuple[float, str]:
    """The largest error among the medians of these systems, and whose it is."""
    asked = errors["system"].isin(aim.systems) & errors["quantity"].str.startswith(aim.quantity)
    worst = errors[asked].dropna().sort_values("error").iloc[-1]
    return float(worst["error"]), str(worst["system"])


KINDS: dict[str, tuple[Callable[[], Iterator[Aim]], Callable[[], pd.DataFrame]]] = {
    "physics": (list_physics_aims, read_physics),
    "forces": (list_force_aims, read_answers),
}


def show_aims(kind: str) -> None:
    """Print the table: quantity, systems, aim, the worst median with its system, and whether it is met."""
    titles = read_titles()
    list_aims, read_errors = KINDS[kind]
    errors = read_errors()
    print("\n| error | systems | aim | worst median | met |\n|---|---|:-:|---|:-:|")
    for aim in list_aims():
        error, system = find_worst(aim, errors)
        met = "yes" if error <= aim.largest else "**no**"
        worst = f"{aim.write(error)} ({titles[system]})"
        print(f"| {aim.quantity} | {aim.title} | {aim.write(aim.largest, 3)} | {worst} | {met} |")
    print()
