"""One writer at a time: Snakemake, its job or both are killed, and the next run ends with the same bits."""

import os
import select
import signal
import subprocess
import sys
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

import pytest

from lagsplat.io.files.lease import locate_lease
from tests.workflow.slurm_node import until
from tests.workflow.test_slurm import ARM, CHECKPOINT, numbers, resumed_at

ROOT = Path(__file__).resolve().parents[2]
TOY = "profile=toy systems=[toy] ablations=[] baselines=[] stage1.steps=4000 stage1.checkpoint_every_s=0.2"
RECORD = ARM / "default-0/autoencoder.json"
MADE = [ARM / "default-0" / name for name in ("autoencoder.safetensors", "curve.csv")]
PATIENCE_S = 600.0  # other programs may want the cores

pytestmark = [
    pytest.mark.slow,
    pytest.mark.skipif(sys.platform != "linux", reason="only Linux ends a job with Snakemake"),
]


def command_in(folder: Path, *words: str) -> Sequence[str]:
    command = [sys.executable, "-m", "snakemake", "--snakefile", str(ROOT / "Snakefile")]
    return [*command, "--directory", str(folder), "--cores", "1", *words, "--config", f"hydra={TOY}"]


def snakemake(folder: Path, *words: str) -> subprocess.CompletedProcess[str]:
    """Snakemake in a folder, to its end."""
    return subprocess.run(
        command_in(folder, str(RECORD), *words),
        env=environment(),
        cwd=folder,
        capture_output=True,
        text=True,
        check=False,
    )


def environment() -> dict[str, str]:
    return {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), os.environ.get("PYTHONPATH", "")])}


@contextmanager
def in_training(folder: Path) -> Iterator[tuple[subprocess.Popen[bytes], int]]:
    """Snakemake while its stage 1 trains, after a checkpoint; with the number of the job's process."""
    with (folder / "driver.log").open("wb") as log:
        driver = subprocess.Popen(
            command_in(folder, str(RECORD)), env=environment(), cwd=folder, stdout=log, stderr=log
        )
    try:
        until((folder / CHECKPOINT).exists, "a checkpoint", patience_s=PATIENCE_S)
        lease = locate_lease(folder / MADE[0]).read_text("utf-8").splitlines()
        yield driver, int(dict(line.split("=") for line in lease[1:])["pid"])
    finally:
        driver.kill()
        driver.wait()


def has_ended(handle: int) -> bool:
    watched = select.poll()
    watched.register(handle, select.POLLIN)
    return bool(watched.poll(1000 * PATIENCE_S))


@pytest.fixture(scope="module")
def undisturbed(tmp_path_factory: pytest.TempPathFactory) -> Path:
    folder = tmp_path_factory.mktemp("undisturbed")
    done = snakemake(folder)
    assert done.returncode == 0, done.stderr[-6000:]
    return folder


@pytest.mark.parametrize(
    "killed", ["driver", *(pytest.param(name, marks=pytest.mark.campaign) for name in ("job", "both"))]
)
def test_what_was_killed_goes_on_to_the_same_bits(undisturbed: Path, tmp_path: Path, killed: str) -> None:
    with in_training(tmp_path) as (driver, job):
        handle = os.pidfd_open(job)
        if killed != "job":
            driver.kill()
        if killed != "driver":
            signal.pidfd_send_signal(handle, signal.SIGKILL)
        assert has_ended(handle), "the job goes on without Snakemake"
        os.close(handle)
        assert driver.wait(PATIENCE_S) != 0
    assert not (tmp_path / RECORD).exists()
    if killed != "job":
        refused = snakemake(tmp_path)
        assert refused.returncode != 0
        assert "cannot be locked" in refused.stderr
        assert snakemake(tmp_path, "--unlock").returncode == 0
    done = snakemake(tmp_path)
    assert done.returncode == 0, done.stderr[-6000:]
    assert resumed_at(tmp_path) > 0
    for name in MADE:
        assert numbers(tmp_path / name) == numbers(undisturbed / name), name
    assert not list(tmp_path.rglob("*.lease"))


def test_a_second_run_that_breaks_the_lock_does_not_write(undisturbed: Path, tmp_path: Path) -> None:
    with in_training(tmp_path) as (driver, job):
        assert snakemake(tmp_path, "--unlock").returncode == 0
        second = snakemake(tmp_path)
        assert second.returncode != 0
        assert f"process {job} on" in second.stderr
        assert "is making it, and two at once would mix their results" in second.stderr
        assert driver.wait(PATIENCE_S) == 0, (tmp_path / "driver.log").read_text("utf-8")[-6000:]
    for name in MADE:
        assert numbers(tmp_path / name) == numbers(undisturbed / name), name


@pytest.mark.parametrize(
    ("option", "reason"),
    [
        ("--keep-incomplete", "keeps what a failed job has left half made"),
        ("--nolock", "lets two runs write the same results"),
    ],
)
def test_options_that_mix_results_are_refused(tmp_path: Path, option: str, reason: str) -> None:
    done = snakemake(tmp_path, option)
    assert done.returncode != 0
    assert f"{option} {reason}" in done.stderr
    assert not (tmp_path / "results").exists()
