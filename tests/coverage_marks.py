"""Prints which share of lines and branches tests reach, and fails below the marks: a plugin of pytest.

Every Python process that finds ``COVERAGE_PROCESS_START``, such as a worker or a job, leaves a file beside
``COVERAGE_FILE``; ``missed.json`` there lists what was missed in ``COVERAGE_FOLDERS``, by default in all.
"""

import json
import os
from pathlib import Path

import coverage
import pytest

ROOT = Path(__file__).resolve().parents[1]
MARKS = {"lagsplat": 90.0, "lagsplat/io": 95.0, "lagsplat/viewer/server": 95.0}  # [%]
FOLDERS = os.environ.get("COVERAGE_FOLDERS", " ".join(MARKS)).split()
LINES = pytest.StashKey[list[str]]()


def measure_shares() -> dict[str, float]:
    """Share of the lines and branches in each folder that was reached [%]."""
    if here := coverage.Coverage.current():
        here.save()
    together = coverage.Coverage(config_file=str(ROOT / "pyproject.toml"))
    together.combine()
    missed = Path(os.environ["COVERAGE_FILE"]).with_name("missed.json")
    together.json_report(include=[f"{ROOT}/{folder}/*" for folder in FOLDERS], outfile=str(missed))
    files = {Path(name): entry["summary"] for name, entry in json.loads(missed.read_text())["files"].items()}
    shares = {}
    for folder in FOLDERS:
        own = [summary for path, summary in files.items() if (ROOT / path).is_relative_to(ROOT / folder)]
        reached = sum(summary["covered_lines"] + summary["covered_branches"] for summary in own)
        shares[folder] = 100.0 * reached / sum(x["num_statements"] + x["num_branches"] for x in own)
    return shares


@pytest.hookimpl(trylast=True)  # after the workers have ended
def pytest_sessionfinish(session: pytest.Session) -> None:
    """Compare with the marks; the session fails below one."""
    if hasattr(session.config, "workerinput"):
        return
    shares = measure_shares()
    session.config.stash[LINES] = [
        f"{share:.1f} % of lines and branches of {name}; the mark is {MARKS[name]:.0f} %"
        for name, share in shares.items()
    ]
    if any(share < MARKS[name] for name, share in shares.items()):
        session.config.stash[LINES].append("Below a mark: build/coverage/missed.json lists what was missed.")
        session.exitstatus = session.exitstatus or pytest.ExitCode.TESTS_FAILED


def pytest_terminal_summary(terminalreporter: pytest.TerminalReporter, config: pytest.Config) -> None:
    """Print the shares before the closing line."""
    terminalreporter.section("coverage")
    for line in config.stash.get(LINES, []):
        terminalreporter.line(line)
