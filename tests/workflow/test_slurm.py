"""The toy profile on a SLURM cluster of one node; and jobs that are preempted, requeued and killed midway.

The node claims a GPU, of which there is none: a job may ask for it, and trains on the CPU.
"""

import csv
import json
import os
import re
import subprocess
import sys
from collections import Counter
from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest
import torch

from tests.workflow.slurm_node import Cluster, SlurmJob, kill_script, one_node, until

ROOT = Path(__file__).resolve().parents[2]
PROFILE = ROOT / "profiles" / "slurm"
# Few jobs, and a checkpoint each second, with time for several of them before the end of stage 1.
TOY = (
    "profile=toy systems=[toy] ablations=[] baselines=[osc_abcd] stage1.steps=900 stage1.checkpoint_every_s=1"
)
ARM = Path("results/toy/simulated/toy")
MADE = (
    "recording.safetensors",
    "truth.safetensors",
    "default-0/autoencoder.safetensors",
    "default-0/curve.csv",
    "default-0/chart.safetensors",
    "default-0/default-0/dynamics.safetensors",
    "default-0/default-0/curve.csv",
)
CHECKPOINT = ARM / "default-0/checkpoint/state.pt"
DYNAMICS = str(ARM / "default-0/default-0/dynamics.json")
# Both stages, baselines, scores and a drawing: jobs alone and in every group.
TARGETS = ("results/tables/krauss.csv", "results/tables/truth.csv", "results/figures/rollout_toy.pdf")
PATIENCE_S = 1500.0  # other programs may want the cores

pytestmark = [pytest.mark.slow, pytest.mark.campaign]


@dataclass(frozen=True)
class Run:
    """Snakemake with the profile for clusters, at work in a folder; what it says is in a file there."""

    cluster: Cluster
    folder: Path
    earlier: frozenset[str]
    process: subprocess.Popen[bytes]

    @classmethod
    def start(cls, cluster: Cluster, folder: Path, *targets: str, profiles: Sequence[Path]) -> "Run":
        command = [sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "Snakefile"), *targets]
        command += ["--directory", str(folder)]
        command += [word for path in profiles for word in ("--profile", str(path))]
        command += ["--config", f"hydra={TOY}", "--slurm-no-account", "--slurm-status-command", "squeue"]
        command += ["--slurm-init-seconds-before-status-checks", "2", "--seconds-between-status-checks", "2"]
        path = os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])
        earlier = frozenset(cluster.jobs())
        with (folder / "snakemake.log").open("wb") as log:
            process = subprocess.Popen(
                command,
                env={**cluster.environment, "PYTHONPATH": path},
                cwd=folder,
                stdout=log,
                stderr=subprocess.STDOUT,
            )
        return cls(cluster, folder, earlier, process)

    def told(self) -> str:
        return (self.folder / "snakemake.log").read_text("utf-8", errors="replace")

    def jobs(self) -> dict[str, SlurmJob]:
        found = self.cluster.jobs().items()
        return {number: job for number, job in found if number not in self.earlier}

    def jobs_of(self, rule: str) -> list[str]:
        """Numbers of the jobs of a rule in SLURM, in the order of their submission."""
        return sorted((n for n, job in self.jobs().items() if f"rule_{rule}_wild" in job.comment), key=int)

    def wait_for(self, met: Callable[[], bool], what: str) -> None:
        def met_while_running() -> bool:
            assert self.process.poll() is None, f"before {what}, Snakemake has ended: {self.told()[-6000:]}"
            return met()

        until(met_while_running, what, patience_s=PATIENCE_S)

    def succeed(self) -> None:
        assert self.process.wait(PATIENCE_S) == 0, self.told()[-6000:]


@pytest.fixture(scope="module")
def cluster(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Cluster]:
    with one_node(tmp_path_factory.mktemp("slurm")) as found:
        yield found


@pytest.fixture(scope="module")
def undisturbed(cluster: Cluster, tmp_path_factory: pytest.TempPathFactory) -> Iterator[Run]:
    """The workflow, run from nothing."""
    run = Run.start(cluster, tmp_path_factory.mktemp("undisturbed"), *TARGETS, profiles=[PROFILE])
    try:
        run.succeed()
        yield run
    finally:
        run.process.kill()


def test_the_toy_profile_runs_on_a_cluster(undisturbed: Run) -> None:
    for target in TARGETS:
        assert (undisturbed.folder / target).stat().st_size
    jobs = undisturbed.jobs().values()
    assert {(job.state, job.restarts, job.resources) for job in jobs} == {("COMPLETED", 0, "")}
    names = Counter(job.comment.removeprefix("rule_").partition("_")[0] for job in jobs)
    assert set(names) == {
        "recordings",
        "stage1",
        "chart",
        "stage2",
        "baseline",
        "ode",
        "scores",
        "figures",
        "tables",
    }
    assert names["scores"] == 1, "the jobs of this group share a submission"


def test_preempted_requeued_and_killed_jobs_give_the_same_bits(undisturbed: Run, tmp_path: Path) -> None:
    run = Run.start(undisturbed.cluster, tmp_path, DYNAMICS, profiles=[PROFILE, PROFILE / "gpu.yaml"])
    try:
        training = _disturb_stage1(run)
        fit = _requeue_stage2(run)
        run.succeed()
    finally:
        run.process.kill()
    jobs = run.jobs()
    gpu = ("gpu", "gres:gpu:1")
    assert [jobs[job][:4] for job in training] == [("FAILED", 1, *gpu), ("COMPLETED", 0, *gpu)]
    assert jobs[fit][:4] == ("COMPLETED", 1, "ordinary", "")
    assert resumed_at(tmp_path) >= 400
    assert not (tmp_path / CHECKPOINT).exists()
    for name in MADE:
        assert numbers(tmp_path / ARM / name) == numbers(undisturbed.folder / ARM / name), name


def numbers(path: Path) -> tuple[object, object]:
    """The bits of an artefact, without the time, the commit and the seconds that it took."""
    if path.suffix == ".csv":
        rows = csv.DictReader(path.read_text("utf-8").splitlines())
        return path.name, [{key: cell for key, cell in row.items() if key != "seconds"} for row in rows]
    content = path.read_bytes()
    end = 8 + int.from_bytes(content[:8], "little")
    index = json.loads(content[8:end])
    del index["__metadata__"]
    assert index
    return index, content[end:]


def _disturb_stage1(run: Run) -> list[str]:
    """Preempt stage 1 by an urgent job, then kill its process; returns the numbers of both its jobs."""
    run.wait_for(lambda: steps_done(run.folder) >= 200, "200 steps of stage 1")
    (job,) = run.jobs_of("stage1")
    run.cluster.ask("sbatch", "--partition=urgent", "--exclusive", "--output=/dev/null", "--wrap=sleep 1")
    run.wait_for(lambda: run.jobs()[job].restarts == 1, "the preemption of stage 1")
    run.wait_for(lambda: steps_done(run.folder) >= 400, "200 more steps")
    assert resumed_at(run.folder) >= 200
    kill_script(run.cluster, job, run.folder)
    run.wait_for(lambda: len(run.jobs_of("stage1")) == 2, "another try of stage 1")
    return run.jobs_of("stage1")


def steps_done(folder: Path) -> int:
    """Steps of stage 1 up to its last checkpoint."""
    path = folder / CHECKPOINT
    if not path.exists():
        return 0
    step: int = torch.load(path, weights_only=True)["state"]["curve"][-1][0]
    return step


def resumed_at(folder: Path) -> int:
    """The step from which the last start of stage 1 has gone on."""
    log = (folder / "results/toy/logs/simulated/toy/default-0/stage1.log").read_text("utf-8")
    found = re.search(r"going on from .* at step (\d+)", log)
    assert found, log
    return int(found[1])


def _requeue_stage2(run: Run) -> str:
    """Requeue stage 2 while it fits; returns its number in SLURM."""
    log = run.folder / "results/toy/logs/simulated/toy/default-0/default-0/stage2.log"
    run.wait_for(log.exists, "the start of stage 2")
    (job,) = run.jobs_of("stage2")
    assert run.jobs()[job].state == "RUNNING"
    run.cluster.ask("scontrol", "requeue", job)
    run.wait_for(lambda: run.jobs()[job].restarts == 1, "another start of stage 2")
    return job
