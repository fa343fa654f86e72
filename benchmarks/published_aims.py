"""The learned physics of the simulated systems beside the project's aims, read from the published table.

What a page shows is written by ``[[[cog show_aims() ]]]``; see `benchmarks.published_tables`.
"""

from collections.abc import Iterator
from typing import NamedTuple

from benchmarks.published_summary import DRIVEN, read_rows
from benchmarks.published_tables import read_titles

ONE = ("pendulum", "rainbow_rocker", "rocking_chair")
TWO = ("hanging_bag", "double_pendulum")
LAW, ROLLOUT = "linearised law", "free rollout"


class Aim(NamedTuple):
    """The largest relative error that is aimed at, of a quantity of mode 1 of some systems."""

    title: str
    systems: tuple[str, ...]
    quantity: str
    largest: float


def list_aims() -> Iterator[Aim]:
    """The aims for the law at rest, for the free rollout, and for equilibria."""
    for source in (LAW, ROLLOUT):
        yield Aim("free systems", (*ONE, *TWO), f"frequency, {source}", 0.005)
        yield Aim("free systems but one", (*ONE, "hanging_bag"), f"decay rate, {source}", 0.10)
        yield Aim("double pendulum", ("double_pendulum",), f"decay rate, {source}", 0.25)
        yield Aim("arm, one segment", ("krauss_1seg",), f"frequency, {source}", 0.05)
        yield Aim("arm, two segments", ("krauss_2seg",), f"frequency, {source}", 0.015)
        yield Aim("both arms", DRIVEN, f"decay rate, {source}", 0.15)
    yield Aim("all", (*ONE, *TWO, *DRIVEN), "equilibrium", 0.1)


def find_worst(aim: Aim) -> tuple[float, str]:
    """The largest error among the medians of these systems, and whose it is."""
    rows = read_rows("quick_simulated_seven/truth", system=aim.systems, recording="simulated")
    names = rows["quantity"].str.replace(" of mode 1,", ",").str.replace(r" \[.*\]", "", regex=True)
    rows = rows[names.str.startswith(aim.quantity) & rows["error"].notna()]
    worst = rows.loc[rows["error"].idxmax()]
    return float(worst["error"]), str(worst["system"])


def show_aims() -> None:
    """Print the table: quantity, systems, aim, the worst median with its system, and whether it is met."""
    titles = read_titles()
    print("\n| mode 1, relative error | systems | aim | worst median | met |\n|---|---|:-:|---|:-:|")
    for aim in list_aims():
        error, system = find_worst(aim)
        met = "yes" if error <= aim.largest else "**no**"
        worst = f"{100 * error:.2g} % ({titles[system]})"
        print(f"| {aim.quantity} | {aim.title} | {100 * aim.largest:g} % | {worst} | {met} |")
    print()
