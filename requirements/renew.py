"""Print the exact versions that ``make`` installs: what pip chooses now for the ranges in pyproject.toml.

Nothing is installed. A version that is to stay is given as an argument, for instance ``torch==2.13.0``.
"""

import json
import re
import subprocess
import sys

HEADER = """# Exact versions for the set-up and the checks, for Python 3.11. Made by `make lock`.
# Packages of CUDA are left out: a CUDA build of torch names its own exactly."""
OF_TORCH = re.compile(r"nvidia-|cuda-|triton$")


def resolve(*wanted: str) -> dict[str, str]:
    """Version of every package that pip would install in an empty environment, by name."""
    command = [sys.executable, "-m", "pip", "install", "--quiet", "--dry-run", "--ignore-installed"]
    done = subprocess.run([*command, "--report", "-", *wanted], stdout=subprocess.PIPE, check=True)
    packages = [item["metadata"] for item in json.loads(done.stdout)["install"]]
    # a build of torch, `+cpu`, is the choice of whoever installs it
    return {re.sub(r"[-_.]+", "-", p["name"]).lower(): p["version"].partition("+")[0] for p in packages}


def main() -> None:
    """Resolve the package with what its tests need, and print one line for each requirement."""
    versions = resolve(".[test]", *sys.argv[1:])
    names = [name for name in sorted(versions) if name != "lagsplat" and not OF_TORCH.match(name)]
    print("\n".join([HEADER, *(f"{name}=={versions[name]}" for name in names)]))


if __name__ == "__main__":
    main()
