"""Processes of the workflow, killed at random moments: what remains, and whether it ends with the same bits.

Usage: ``python -m tests.campaign.faults SEED KILLS [slurm]``. The toy workflow runs once undisturbed. Then it
is started over and over: at a random moment Snakemake alone is killed, or one of its jobs, or both, and the
next start goes on in the same folder, until it ends by itself; then the next folder begins. Under SLURM a job
is killed or requeued instead. Findings are a process that outlives a killed Snakemake, a finished result that
changed or is gone, a start that fails, a lease that is left, and results that differ from the undisturbed
ones. Prints a line for each kill and the counts; the exit code is 1 if there is a finding. Linux only.
"""

import os
import random
import select
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from collections.abc import Callable
from contextlib import nullcontext
from dataclasses import dataclass, field
from pathlib import Path

from tests.workflow.slurm_node import Cluster, kill_script, one_node
from tests.workflow.test_slurm import ARM, MADE, PROFILE, ROOT, TARGETS, TOY, numbers

LEAST_S = 30.0  # within which everything that a killed Snakemake has started is gone
LONGEST_S = 1800.0  # of one start
Disturb = Callable[["Campaign", subprocess.Popen[bytes], Path], str]


@dataclass
class Campaign:
    """The counts of a campaign, and what it found."""

    chance: random.Random
    cluster: Cluster | None
    kills: Counter[str] = field(default_factory=Counter)
    findings: list[str] = field(default_factory=list)

    def find(self, text: str) -> None:
        print(f"FINDING {text}", flush=True)
        self.findings.append(text)

    def start(self, folder: Path) -> subprocess.Popen[bytes]:
        """Snakemake at work in a folder; what it says is appended to a file there."""
        command = [sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "Snakefile"), *TARGETS]
        command += ["--directory", str(folder), "--rerun-incomplete"]
        if self.cluster is None:
            command += ["--cores", "2"]
        else:
            command += ["--profile", str(PROFILE), "--slurm-no-account", "--slurm-status-command", "squeue"]
            command += ["--slurm-init-seconds-before-status-checks", "2"]
            command += ["--seconds-between-status-checks", "2"]
        environment = os.environ if self.cluster is None else self.cluster.environment
        path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
        with (folder / "snakemake.log").open("ab") as log:
            return subprocess.Popen(
                [*command, "--config", f"hydra={TOY}"],
                env={**environment, "PYTHONPATH": path},
                cwd=folder,
                stdout=log,
                stderr=subprocess.STDOUT,
            )

    def unlock(self, folder: Path) -> None:
        command = [sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "Snakefile"), "--unlock"]
        command += ["--directory", str(folder), "--cores", "1", "--config", f"hydra={TOY}"]
        environment = {**os.environ, "PYTHONPATH": str(ROOT)}
        done = subprocess.run(
            command, cwd=folder, env=environment, capture_output=True, text=True, check=False
        )
        if done.returncode:
            self.find(f"{folder.name}: --unlock fails: {done.stderr[-500:]}")


def list_descendants(parent: int) -> dict[int, int]:
    """Handles of the processes that a process has started, and that those have, by their numbers."""
    children: dict[int, list[int]] = {}
    for place in Path("/proc").glob("[0-9]*/stat"):
        try:
            fields = place.read_text("utf-8").rpartition(")")[2].split()
        except OSError:  # it has ended
            continue
        children.setdefault(int(fields[1]), []).append(int(place.parent.name))
    found, left = {}, [parent]
    while left:
        for child in children.get(left.pop(), []):
            left.append(child)
            try:
                found[child] = os.pidfd_open(child)
            except OSError:
                continue
    return found


def has_ended(handle: int, *, within_s: float) -> bool:
    """Whether a process ends in time; its handle is closed."""
    watched = select.poll()
    watched.register(handle, select.POLLIN)
    ended = bool(watched.poll(int(1000 * within_s)))
    os.close(handle)
    return ended


def runs_script(number: int) -> bool:
    """Whether a process runs a script of the workflow."""
    try:
        words = Path(f"/proc/{number}/cmdline").read_text("utf-8", errors="replace")
    except OSError:  # it has ended
        return False
    return "/.snakemake/scripts/" in words


def list_finished(folder: Path) -> dict[Path, object]:
    """Bits of the artefacts beside which a record says that they are finished."""
    paths = [folder / ARM / name for name in MADE]
    return {path: numbers(path) for path in paths if path.with_suffix(".json").exists() and path.exists()}


def kill_processes(campaign: Campaign, driver: subprocess.Popen[bytes], folder: Path) -> str:
    """Kill Snakemake, or a job, or both; returns which."""
    below = list_descendants(driver.pid)
    jobs = [number for number in below if runs_script(number)]
    whom = campaign.chance.choice(["Snakemake", "Snakemake", "job", "both"])
    if not jobs:
        whom = "Snakemake"
    if whom != "job":
        driver.kill()
    if whom != "Snakemake":
        signal.pidfd_send_signal(below[jobs[0]], signal.SIGKILL)
    driver.wait(LONGEST_S)
    for number, handle in below.items():
        if not has_ended(handle, within_s=LEAST_S):
            campaign.find(f"{folder.name}: process {number} goes on {LEAST_S:.0f} s after {whom} was killed")
    if whom != "job":
        campaign.unlock(folder)
    return whom


def disturb_cluster(campaign: Campaign, driver: subprocess.Popen[bytes], folder: Path) -> str:
    """Kill the script of a running job of SLURM, or let SLURM requeue the job; empty where none runs."""
    assert campaign.cluster is not None
    del driver
    running = [number for number, job in campaign.cluster.jobs().items() if job.state == "RUNNING"]
    if not running:
        return ""
    job = campaign.chance.choice(running)
    if campaign.chance.random() < 0.5:
        campaign.cluster.ask("scontrol", "requeue", job)
        return "requeued"
    try:
        kill_script(campaign.cluster, job, folder)
    except AssertionError:  # between two scripts of its group
        return ""
    return "job"


def compare(campaign: Campaign, folder: Path, reference: Path) -> None:
    """Find what differs from the undisturbed results, and what should not be there."""
    for name in MADE:
        if numbers(folder / ARM / name) != numbers(reference / ARM / name):
            campaign.find(f"{folder.name}: {name} differs from the undisturbed one")
    for target in TARGETS:
        if not (folder / target).exists():
            campaign.find(f"{folder.name}: {target} is missing")
    for lease in folder.rglob("*.lease"):
        campaign.find(f"{folder.name}: {lease.name} is left")


def run_once(campaign: Campaign, folder: Path, longest_s: float, disturb: Disturb) -> bool:
    """Start the workflow, disturb it at a random moment; whether it came to its end."""
    finished = list_finished(folder)
    driver = campaign.start(folder)
    # A later moment of one start is an earlier one of the next, which goes on where this one ends.
    moment = campaign.chance.uniform(0.0, longest_s / 2)
    try:
        driver.wait(moment)
    except subprocess.TimeoutExpired:
        while not (whom := disturb(campaign, driver, folder)) and driver.poll() is None:
            time.sleep(0.2)  # no job of SLURM runs at this moment
        if whom:
            campaign.kills[whom] += 1
            print(f"{sum(campaign.kills.values())} {folder.name} {whom} after {moment:.1f} s", flush=True)
        if campaign.cluster is not None:
            driver.wait(LONGEST_S)
        ended = driver.returncode == 0
    else:
        ended = driver.returncode == 0
        if not ended:
            told = (folder / "snakemake.log").read_text("utf-8", errors="replace")
            campaign.find(f"{folder.name}: Snakemake ends with {driver.returncode}: {told[-1500:]}")
            shutil.copy(folder / "snakemake.log", f"failed-{folder.name}.log")
    # killed between a job's record and Snakemake's own note of its end, a job is done again
    for path, content in finished.items():
        if (path.exists() and numbers(path) != content) or (ended and not path.exists()):
            campaign.find(f"{folder.name}: {path.name} was finished and has changed or is gone")
    return ended


def main(seed: int, kills: int, *, slurm: bool = False) -> int:
    """Run the campaign; returns the exit code."""
    with tempfile.TemporaryDirectory() as place, one_node(Path(place)) if slurm else nullcontext() as cluster:
        campaign = Campaign(random.Random(seed), cluster)
        reference = Path(place) / "undisturbed"
        reference.mkdir()
        began = time.monotonic()
        if campaign.start(reference).wait(LONGEST_S):
            print((reference / "snakemake.log").read_text("utf-8")[-6000:])
            return 1
        longest_s, folder, number = time.monotonic() - began, None, 0
        print(f"undisturbed: {longest_s:.0f} s", flush=True)
        while sum(campaign.kills.values()) < kills:
            if folder is None:
                number += 1
                folder = Path(place) / f"run-{number}"
                folder.mkdir()
            if run_once(campaign, folder, longest_s, disturb_cluster if slurm else kill_processes):
                compare(campaign, folder, reference)
                shutil.rmtree(folder)
                folder = None
            if len(campaign.findings) > 20:
                break
    print(f"seed {seed}: {dict(campaign.kills)} kills, {number} folders, {len(campaign.findings)} findings")
    return 1 if campaign.findings else 0


if __name__ == "__main__":
    sys.exit(main(int(sys.argv[1]), int(sys.argv[2]), slurm="slurm" in sys.argv[3:]))
