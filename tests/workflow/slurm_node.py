"""A SLURM cluster of one node on this machine, or the reason why there is none.

Settings, keys, sockets, state and logs are in one folder, nothing in `/etc`, and the daemons run as whoever
runs the tests. Nothing of them stays.
"""

import os
import shutil
import signal
import socket
import subprocess
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from getpass import getuser
from importlib.util import find_spec
from pathlib import Path
from typing import NamedTuple

import pytest

PROGRAMS = ("munged", "slurmctld", "slurmd", "sbatch", "squeue", "scontrol")
PLUGIN = "snakemake_executor_plugin_slurm"
CPUS, MEMORY_MB = 16, 64_000
"""What the node claims to have, as well as a GPU: jobs wait for each other no more than on a larger one."""
SETTINGS = """
ClusterName=test
SlurmctldHost=localhost(127.0.0.1)
SlurmUser={user}
SlurmdUser={user}
SlurmctldPort={controller}
SlurmdPort={node}
AuthType=auth/munge
# a requeued job starts again no earlier than its credential expires
AuthInfo=socket={folder}/munge.socket,cred_expire=5
StateSaveLocation={folder}/state
SlurmdSpoolDir={folder}/spool
SlurmctldPidFile={folder}/slurmctld.pid
SlurmdPidFile={folder}/slurmd.pid
ProctrackType=proctrack/linuxproc
TaskPlugin=task/none
JobAcctGatherType=jobacct_gather/none
AccountingStorageType=accounting_storage/none
MpiDefault=none
SelectType=select/cons_tres
SelectTypeParameters=CR_CPU_Memory
SlurmdParameters=config_overrides
PreemptType=preempt/partition_prio
PreemptMode=REQUEUE
KillWait=2
MinJobAge=86400
SchedulerParameters=batch_sched_delay=0,sched_min_interval=0
GresTypes=gpu
NodeName=localhost NodeAddr=127.0.0.1 CPUs={cpus} RealMemory={memory_mb} Gres=gpu:1
PartitionName=ordinary Nodes=localhost Default=YES PriorityTier=1 MaxTime=INFINITE
PartitionName=gpu Nodes=localhost PriorityTier=1 MaxTime=INFINITE
PartitionName=urgent Nodes=localhost PriorityTier=2 PreemptMode=OFF MaxTime=INFINITE
"""
# What a job starts on the node has no SLURM_CONF: Snakemake's plugin takes all SLURM_* away before `srun`.
STEP = '#!/bin/sh\nSLURM_CONF={settings} exec {srun} "$@"\n'


class SlurmJob(NamedTuple):
    """What SLURM says of a job; ``comment`` names its rule or group."""

    state: str
    restarts: int
    partition: str
    resources: str
    comment: str


@dataclass(frozen=True)
class Cluster:
    """A running cluster: the environment in which its commands find it."""

    environment: dict[str, str]

    def ask(self, *words: str) -> str:
        """What a command of SLURM prints."""
        done = subprocess.run(words, env=self.environment, capture_output=True, text=True, check=False)
        assert done.returncode == 0, f"{words}: {done.stderr}"
        return done.stdout

    def jobs(self) -> dict[str, SlurmJob]:
        """Every job by its number, finished ones included."""
        lines = self.ask("scontrol", "--oneliner", "show", "job").splitlines()
        rows = [dict(word.split("=", 1) for word in line.split(" ") if "=" in word) for line in lines]
        return {
            row["JobId"]: SlurmJob(
                row["JobState"],
                int(row["Restarts"]),
                row["Partition"],
                row.get("TresPerJob", ""),
                row.get("Comment", ""),
            )
            for row in rows
            if "JobId" in row
        }


def until(met: Callable[[], bool], what: str, *, patience_s: float) -> None:
    """Wait until something is so."""
    end = time.monotonic() + patience_s
    while not met():
        assert time.monotonic() < end, f"{what}: not within {patience_s:.0f} s"
        time.sleep(0.1)


def _free_port() -> int:
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port: int = probe.getsockname()[1]
        return port


def _write_settings(folder: Path) -> dict[str, str]:
    """The files of the cluster; returns the environment in which its commands find it."""
    for name in ("state", "spool", "bin"):
        (folder / name).mkdir()
    settings, step, key = folder / "slurm.conf", folder / "bin" / "srun", folder / "munge.key"
    ports = {"controller": _free_port(), "node": _free_port()}
    (folder / "gres.conf").write_text("Name=gpu File=/dev/null\n", "utf-8")
    settings.write_text(
        SETTINGS.format(folder=folder, user=getuser(), cpus=CPUS, memory_mb=MEMORY_MB, **ports), "utf-8"
    )
    step.write_text(STEP.format(settings=settings, srun=shutil.which("srun")), "utf-8")
    step.chmod(0o755)
    key.write_bytes(os.urandom(128))
    key.chmod(0o600)
    path = os.pathsep.join([str(folder / "bin"), os.environ["PATH"]])
    return {**os.environ, "PATH": path, "SLURM_CONF": str(settings)}


def _commands(folder: Path) -> list[list[str]]:
    """The daemons in the foreground, in the order in which they start."""
    files = {"key-file": "munge.key", "socket": "munge.socket", "pid-file": "munged.pid"}
    files |= {"log-file": "munged.log", "seed-file": "munged.seed"}
    found = {name: str(shutil.which(name, path=_search_path())) for name in PROGRAMS}
    return [
        # --force: the folder of a test is closed to other users
        [
            found["munged"],
            "--foreground",
            "--force",
            *(f"--{name}={folder / file}" for name, file in files.items()),
        ],
        [found["slurmctld"], "-D"],
        [found["slurmd"], "-D", "-N", "localhost"],
    ]


def _search_path() -> str:
    return os.pathsep.join([os.environ["PATH"], "/usr/sbin", "/sbin"])


def _skip_unless_installed() -> None:
    missing = [name for name in PROGRAMS if shutil.which(name, path=_search_path()) is None]
    if missing:
        pytest.skip(f"no SLURM on this machine ({', '.join(missing)}); apt-get install slurm-wlm munge")
    if find_spec(PLUGIN) is None:
        pytest.skip(f'{PLUGIN} is not installed; pip install --editable ".[cluster]"')


def _stop(daemons: Sequence[subprocess.Popen[bytes]]) -> None:
    for daemon in reversed(daemons):
        daemon.terminate()
        try:
            daemon.wait(timeout=20)
        except subprocess.TimeoutExpired:
            daemon.kill()
            daemon.wait()


@contextmanager
def one_node(folder: Path) -> Iterator[Cluster]:
    """SLURM on this machine until the block ends; where it is not installed or does not start, the test is
    skipped."""
    _skip_unless_installed()
    environment = _write_settings(folder)
    cluster, daemons = Cluster(environment), []
    try:
        with (folder / "daemons.log").open("wb") as log:
            for command in _commands(folder):
                daemons.append(subprocess.Popen(command, env=environment, stdout=log, stderr=log))
                time.sleep(1.0)  # each looks for the one before it only once
        if not _answers(cluster):
            told = (folder / "daemons.log").read_text("utf-8", errors="replace")
            pytest.skip(f"SLURM does not start on this machine: {told[-1500:]}")
        yield cluster
    finally:
        if len(daemons) == 3:
            subprocess.run(["scancel", f"--user={getuser()}"], env=environment, check=False, timeout=30)
            _wait_for_the_end(cluster)
        _stop(daemons)


def _answers(cluster: Cluster, patience_s: float = 60.0) -> bool:
    end = time.monotonic() + patience_s
    while time.monotonic() < end:
        done = subprocess.run(
            ["sinfo", "--noheader", "--format=%T"], env=cluster.environment, capture_output=True, text=True
        )
        if "idle" in done.stdout:
            return True
        time.sleep(0.5)
    return False


def _wait_for_the_end(cluster: Cluster) -> None:
    """Until no job is left: a daemon that stops leaves what it has started alone."""
    end = time.monotonic() + 30.0
    while time.monotonic() < end:
        left = subprocess.run(
            ["squeue", "--noheader"], env=cluster.environment, capture_output=True, text=True, check=False
        )
        if left.returncode or not left.stdout.strip():
            return
        time.sleep(0.5)


def kill_script(cluster: Cluster, job: str, folder: Path) -> None:
    """End the script that a job runs in ``folder``, as a crash would."""
    for pid in cluster.ask("scontrol", "listpids", job).splitlines()[1:]:
        place = Path("/proc") / pid.split()[0] / "cmdline"
        words = place.read_text("utf-8").split("\0") if place.exists() else []
        if any(str(folder / ".snakemake" / "scripts") in word for word in words[1:2]):
            os.kill(int(place.parent.name), signal.SIGKILL)
            return
    raise AssertionError(f"job {job} runs no script in {folder}")
