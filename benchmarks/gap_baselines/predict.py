"""Predictions: ``python -m benchmarks.gap_baselines.predict --method chance --out DIR FOLDER ...``.

Each ``FOLDER`` holds ``sim_*.csv`` and ``real_*.csv``; ``DIR/<its name>/diagnosis.json`` gets the prediction.
Where a method fails the reason stands in ``failed.txt`` instead.
"""

import argparse
import json
import sys
import warnings
from collections.abc import Callable
from pathlib import Path

from benchmarks.gap_baselines.case import Case, open_case
from benchmarks.gap_baselines.said import Said, write
from lagsplat.config.compose import compose, rebuild
from lagsplat.diagnose.core.config import DiagnoseConfig

METHODS = ("chance", "discrepancy_test", "ensemble_sindy", "lowest_error", "mujoco_sysid")
Method = Callable[[Case, DiagnoseConfig], Said]


def method_of(name: str) -> Method:
    """One of `METHODS`; its libraries are loaded with it and no others.

    Raises:
        ValueError: none such.
    """
    if name == "chance":
        from benchmarks.gap_baselines.chance import chance as method
    elif name == "discrepancy_test":
        from benchmarks.gap_baselines.discrepancy_test import discrepancy_test as method
    elif name == "ensemble_sindy":
        from benchmarks.gap_baselines.sindy import ensemble_sindy as method
    elif name == "mujoco_sysid":
        from benchmarks.gap_baselines.mujoco_fit import mujoco_sysid as method
    elif name == "lowest_error":
        from benchmarks.gap_baselines.lowest_error import lowest_error as method
    else:
        raise ValueError(f"no method {name!r}; choose from {', '.join(METHODS)}")
    return method


def predict(method: Method, place: Path, out: Path, config: DiagnoseConfig) -> bool:
    """Write one method's prediction of the recording in ``place`` to ``out``; False where it failed."""
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # of every method's own numerics; what it says is judged
            said = method(open_case(place), config)
    except Exception as error:  # a recording that one method cannot take must not end the others
        out.mkdir(parents=True, exist_ok=True)
        (out / "failed.txt").write_text(f"{type(error).__name__}: {error}\n", encoding="utf-8")
        print(f"{place.name}: {type(error).__name__}: {error}", file=sys.stderr)
        return False
    write(said, out)
    return True


def main(argv: list[str] | None = None) -> None:
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter
    )
    parser.add_argument("--method", choices=METHODS, required=True, help="who predicts")
    parser.add_argument("--out", type=Path, required=True, help="folder to write")
    parser.add_argument("--settings", help="settings of a diagnosis as JSON; default: those of conf/")
    parser.add_argument("folders", type=Path, nargs="*", help="recordings")
    args = parser.parse_args(argv)
    config = rebuild(DiagnoseConfig, json.loads(args.settings)) if args.settings else compose().diagnose
    method = method_of(args.method)
    for place in args.folders:
        predict(method, place, args.out / place.name, config)


if __name__ == "__main__":
    main()
