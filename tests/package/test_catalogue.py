"""What the catalogue of Snakemake workflows and other workflows need of this one."""

import json
import os
import subprocess
import sys
from pathlib import Path

import pytest
import yaml

from lagsplat.planning.plan import read_overrides, shared_experiment
from lagsplat.project import PARTS, VARIABLE

ROOT = Path(__file__).resolve().parents[2]
MODULE = f"""
configfile: "config/config.yaml"

module lagsplat:
    snakefile: "{ROOT / "Snakefile"}"
    config: config

use rule * from lagsplat
"""


def test_the_catalogue_finds_what_it_asks_for() -> None:
    usage = yaml.safe_load((ROOT / ".snakemake-workflow-catalog.yml").read_text())["usage"]
    assert set(usage) == {"mandatory-flags", "software-stack-deployment", "report"}
    assert usage["report"] is True
    assert usage["software-stack-deployment"]["conda"] is (ROOT / "workflow/envs/lagsplat.yaml").is_file()
    assert "pip install lagsplat" in usage["mandatory-flags"]["desc"]
    given = yaml.safe_load((ROOT / "config" / "config.yaml").read_text())
    assert shared_experiment(read_overrides(given)).choices["profile"] == "quick"


@pytest.mark.slow
def test_another_workflow_loads_this_one_as_a_module(tmp_path: Path) -> None:
    for name in ("config", "workflow"):
        (tmp_path / name).mkdir()
    (tmp_path / "config" / "config.yaml").write_text('hydra: "profile=toy"\n')
    (tmp_path / "workflow" / "Snakefile").write_text(MODULE)
    environment = {name: value for name, value in os.environ.items() if name != VARIABLE}
    done = subprocess.run(
        [sys.executable, "-m", "snakemake", "-c2", "-n", "results/tables/physical.tex"],
        capture_output=True,
        text=True,
        cwd=tmp_path,
        env={**environment, "PYTHONPATH": str(ROOT)},
    )
    assert done.returncode == 0, (done.stdout + done.stderr)[-4000:]
    assert "results/toy/simulated/toy/default-0/autoencoder.safetensors" in done.stdout + done.stderr


def test_the_workflow_and_its_results_make_a_crate(tmp_path: Path) -> None:
    pytest.importorskip("rocrate", reason="rocrate is not installed")
    (tmp_path / "results" / "tables").mkdir(parents=True)
    (tmp_path / "results" / "tables" / "krauss.tex").write_text("a table")
    program = ROOT / "workflow" / "crate.py"
    environment = {**os.environ, "PYTHONPATH": os.pathsep.join([str(ROOT), *sys.path[1:]])}
    command = [sys.executable, str(program), "crate"]
    subprocess.run(command, cwd=tmp_path, env=environment, check=True)
    graph = json.loads((tmp_path / "crate" / "ro-crate-metadata.json").read_text())["@graph"]
    entities = {entity["@id"]: entity for entity in graph}
    assert entities["./"]["mainEntity"] == {"@id": "Snakefile"}
    assert "ComputationalWorkflow" in entities["Snakefile"]["@type"]
    assert {"conf/config.yaml", "workflow/rules/stage1.smk", "results/tables/krauss.tex"} <= set(entities)
    assert {path.name for path in (tmp_path / "crate").iterdir()} >= set(PARTS)
    done = subprocess.run(command, cwd=tmp_path, env=environment, capture_output=True, text=True)
    assert done.returncode == 1
    assert "crate holds files; name a folder" in done.stderr
