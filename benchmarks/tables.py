"""What it costs to read a trajectory from a CSV of three million rows: time and peak memory.

Usage: ``python -m benchmarks.tables [rows]``. Writes ``t,q0,u0`` in a temporary folder in several dresses
(commas, semicolons with decimal commas, CR line ends, remarks, an unused column of words) and reads each in a
process of its own. Memory is the highest resident size of that process less that after the imports (Linux).
"""

import subprocess
import sys
import tempfile
from pathlib import Path

import numpy as np

ROWS = 3_000_000
READ = """
import re, sys, time, warnings
from pathlib import Path
import pyarrow.csv
from lagsplat.io.trajectory.trajectory import read_trajectory_file
warnings.simplefilter("ignore")
peak = lambda: int(re.search(r"VmHWM:\\s*(\\d+)", Path("/proc/self/status").read_text())[1]) / 1024
before, began, worked = peak(), time.perf_counter(), time.process_time()
motion = read_trajectory_file(sys.argv[1])
wall, work = time.perf_counter() - began, time.process_time() - worked
print(motion.n, f"{wall:.2f} {work:.2f} {peak() - before:.0f}")
"""


def write_rows(path: Path, rows: int) -> bytes:
    """Write the tidy file, 1 kHz and nine digits, and return its bytes."""
    time_s = np.arange(rows) / 1000.0
    columns = (time_s, np.sin(time_s), np.cos(3.0 * time_s))
    np.savetxt(path, np.stack(columns, axis=1), "%.9g", ",", header="t,q0,u0", comments="")
    return path.read_bytes()


def main(rows: int) -> None:
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "log.csv"
        tidy = write_rows(path, rows)
        worded = tidy.replace(b"\n", b",idle\n").replace(b"u0,idle", b"u0,mode")
        dresses = {
            "tidy": tidy,
            "semicolons": tidy.replace(b",", b";").replace(b".", b","),
            "CR": tidy.replace(b"\n", b"\r"),
            "remarks": b"# a log\n" + tidy.replace(b"\n9,", b" # late\n9,"),
            "words": worded,
        }
        print(
            f"{rows} rows, {len(tidy) / 1e6:.0f} MB; "
            "rows read, time [s], time of the processor [s], peak memory [MiB]"
        )
        for name, content in dresses.items():
            path.write_bytes(content)
            done = subprocess.run(
                [sys.executable, "-c", READ, str(path)], capture_output=True, text=True, check=True
            )
            print(f"{name:<12}{done.stdout.strip()}")


if __name__ == "__main__":
    main(int(sys.argv[1]) if len(sys.argv) > 1 else ROWS)
