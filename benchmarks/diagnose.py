"""Time to diagnose a recording against the whole catalogue, as a multiple of the recording's own length.

Usage: ``python -m benchmarks.diagnose [d1|d2|d4|minute_d1|minute_d2]...``. Makes recordings with a withheld
effect in a temporary folder (`benchmarks/gapgen`; 1 % noise; 20 s with one coordinate, 40 s with two and with
four, at 60 Hz; a minute at 100 Hz) and runs ``lagsplat diagnose`` on each, start and report included. Marks
on two cores: 3 lengths for d1, 15 for d4.
"""

import json
import subprocess
import sys
import tempfile
import time
from pathlib import Path

from benchmarks.gapgen.drawing import Stratum
from benchmarks.gapgen.make import make_one
from benchmarks.gapgen.sensors import Conditions, Sensor

FAST = Conditions(100.0, Sensor(), (3.0,), tolerance=1.0, sine=False)
CASES = {
    "d1": Stratum(("coulomb_friction",), "pendulum", forced=True, noise=0.01, duration_s=20.0, bin="middle"),
    "d2": Stratum(("coulomb_friction",), "two_link", forced=True, noise=0.01, duration_s=40.0, bin="middle"),
    "d4": Stratum(("input_lag",), "soft_robot", forced=True, noise=0.01, duration_s=40.0, bin="middle"),
    "minute_d1": Stratum(("coulomb_friction",), "pendulum", True, 0.01, 60.0, "middle", conditions=FAST),
    "minute_d2": Stratum(("coulomb_friction",), "two_link", True, 0.01, 60.0, "middle", conditions=FAST),
}


def diagnose(case: str, folder: Path) -> tuple[float, dict[str, object]]:
    """Seconds that the command takes, and what it found."""
    make_one((case, CASES[case], 1, "speed", str(folder), "T0"))
    data, out = folder / "data" / case, folder / f"diagnosis_{case}"
    words = ["diagnose", f"sim={data}/sim_*.csv", f"real={data}/real_0.csv", f"out={out}"]
    command = Path(sys.executable).with_name("lagsplat")
    began = time.perf_counter()
    subprocess.run([command, *words], check=True, capture_output=True)
    seconds = time.perf_counter() - began
    return seconds, json.loads((out / "diagnosis.json").read_text(encoding="utf-8"))


def main(names: list[str]) -> None:
    with tempfile.TemporaryDirectory() as folder:
        for case in names or list(CASES):
            seconds, found = diagnose(case, Path(folder))
            length = CASES[case].duration_s
            print(
                f"{case}: {length:g} s of {CASES[case].system} diagnosed in {seconds:.0f} s, "
                f"{seconds / length:.1f} times its length: {found['verdict']}, {found['combination']}"
            )


if __name__ == "__main__":
    main(sys.argv[1:])
