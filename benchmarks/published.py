"""Make what stands in ``results/published`` again, at one commit, with a manifest of how each file was made.

Usage: ``python -m benchmarks.published [FOLDER ...]``, or all folders of ``published.yaml``. The workflow
runs in ``build/published``, so a call that was stopped goes on, and the minutes of all calls are counted.
Uncommitted changes are refused: the manifest names the commit. Figures are reduced to `WIDEST` pixels and
written as WebP. The tables of the pages follow at the end.
"""

import json
import os
import platform
import shlex
import shutil
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import asdict
from pathlib import Path
from typing import Any

import yaml
from PIL import Image

from benchmarks.drawn_systems import draw_overrides
from benchmarks.published_tables import PUBLISHED, write_pages
from lagsplat.io.files.atomic import save_json, sha256_of, write_text
from lagsplat.planning.plan import compose_for, read_overrides, shared_experiment
from lagsplat.provenance import sha256_hex

ROOT = Path(__file__).resolve().parents[1]
PLAN = Path(__file__).with_name("published.yaml")
MANIFEST = PUBLISHED / "manifest.json"
WORK = ROOT / "build" / "published"
WIDEST, QUALITY = 1400, 80  # of a figure [pixel; WebP's scale], so that all files stay below 3 MB
FIGURE = ".webp"
TICK_S = 10.0  # between two records of the time taken, of which a killed call loses the last


def read_plan() -> dict[str, dict[str, Any]]:
    """The folders, each with its settings and its files; without the campaigns."""
    plan: dict[str, dict[str, Any]] = yaml.safe_load(PLAN.read_text("utf-8"))
    del plan["campaigns"]
    for folder in plan.values():
        if "draw" in folder:
            folder["systems"] = draw_overrides(folder["draw"])
    return plan


def work_of(name: str, folder: dict[str, Any]) -> Path:
    """Where the workflow runs for a folder; drawn systems have paths of others, so a place of their own."""
    return WORK / name if "draw" in folder else WORK


def place_of(name: str, folder: dict[str, Any]) -> Path:
    """Where the files of a folder stand."""
    return ROOT / folder["into"] if "into" in folder else PUBLISHED / name


def name_commit() -> str:
    """The commit that is checked out.

    Raises:
        SystemExit: files differ from it.
    """

    def git(*words: str) -> str:
        done = subprocess.run(["git", *words], cwd=ROOT, capture_output=True, text=True, check=True)
        return done.stdout.strip()

    own = (":!results/published", ":!docs", ":!README.md")  # what this program writes
    changed = git("status", "--porcelain", "--", ".", *own)
    if changed:
        sys.exit(f"not committed, so the manifest could not say what made its files:\n{changed}")
    return git("rev-parse", "--short=10", "HEAD")


def make_folder(name: str, folder: dict[str, Any]) -> dict[str, Any]:
    """Run the workflow for a folder, take its files, and return its entry of the manifest."""
    commit, clock = name_commit(), WORK / f"{name}.minutes"
    files = {key: {"needs": made} if isinstance(made, str) else made for key, made in folder["files"].items()}
    command = write_command(folder, [each["needs"] for each in files.values() if "needs" in each])
    work = work_of(name, folder)
    work.mkdir(parents=True, exist_ok=True)
    where = ["--snakefile", str(ROOT / "Snakefile"), "--directory", str(work)]
    words = [word.replace("{data}", os.environ.get(folder.get("data", ""), "")) for word in command]
    if not words:
        clock.unlink(missing_ok=True)  # nothing that an earlier call made is taken
    else:
        run_timed([sys.executable, "-m", *words, *where], clock)
    into = place_of(name, folder)
    into.mkdir(parents=True, exist_ok=True)
    entry: dict[str, Any] = {}
    for key, made in files.items():
        out = into / key
        if "command" in made:
            source = WORK / f"{name}-{out.stem}.png" if out.suffix == FIGURE else out
            told = made["command"].format(run=work / "results", out=source, published=PUBLISHED)
            words = [sys.executable if word == "python" else word for word in shlex.split(told)]
            run_timed(words, clock)
        else:
            source = work / made["needs"]
        take_file(source, out)
        entry[key] = {"made_by": made.get("command") or made["needs"], "sha256": sha256_of(out)}
    return {
        "commit": commit,
        "command": shlex.join(command),
        **(describe_settings(folder) if command else {}),
        "minutes": round(float(clock.read_text("utf-8")), 1),
        "machine": f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}",
        "files": entry,
    }


def run_timed(words: list[str], clock: Path) -> None:
    """Run a command, and add the minutes that it takes to those in the file ``clock`` while it runs.

    Raises:
        subprocess.CalledProcessError: the command failed.
    """
    with subprocess.Popen(words, cwd=WORK, env=_environment()) as process:
        before, began = float(clock.read_text("utf-8")) if clock.exists() else 0.0, time.monotonic()
        while process.returncode is None:
            with suppress(subprocess.TimeoutExpired):
                process.wait(TICK_S)
            write_text(clock, str(before + (time.monotonic() - began) / 60.0))
    if process.returncode:
        raise subprocess.CalledProcessError(process.returncode, words)


def describe_settings(folder: dict[str, Any]) -> dict[str, Any]:
    """The seeds of a folder's runs, and a digest of their settings."""
    of_system = {f"hydra_{name}": words for name, words in folder.get("systems", {}).items()}
    given = {"hydra": folder.get("settings", ""), **of_system}
    overrides = read_overrides({key: words.replace("{data}", "data") for key, words in given.items()})
    shared = shared_experiment(overrides)
    composed = [asdict(compose_for(overrides, system=system)) for system in shared.systems]
    return {
        "seeds": {
            "runs": list(shared.seeds),
            "published baselines": list(shared.baseline_seeds),
            "forecasters": list(shared.forecaster_seeds),
        },
        "settings_sha256": sha256_hex(json.dumps(composed, sort_keys=True, default=str).encode()),
    }


def write_command(folder: dict[str, Any], targets: list[str]) -> list[str]:
    """The call of the workflow for these files, with ``{data}`` in the place of a folder; empty for none."""
    config = [f"hydra={folder['settings']}"] if folder.get("settings") else []
    config += [f"hydra_{system}={words}" for system, words in folder.get("systems", {}).items()]
    begin = ["snakemake", f"-c{os.cpu_count()}", *targets] if targets else []
    return begin + (["--config", *config] if config else [])


def _environment() -> dict[str, str]:
    path = os.pathsep.join([str(Path(sys.executable).parent), os.environ.get("PATH", "")])
    return {**os.environ, "PATH": path, "PYTHONPATH": str(ROOT)}


def take_file(made: Path, out: Path) -> None:
    """Copy a file unless it is in place; a figure is reduced and written as WebP."""
    if out.suffix == FIGURE:
        with Image.open(made) as figure:
            picture = figure.convert("RGB")
            picture.thumbnail((WIDEST, 4 * WIDEST))
            picture.save(out, quality=QUALITY, method=6)
    elif made != out:
        shutil.copy(made, out)


def main(*names: str) -> None:
    """Make the named folders, and write the manifest after each."""
    plan = read_plan()
    if unknown := set(names) - set(plan):
        sys.exit(f"no folder {', '.join(sorted(unknown))}; choose from {', '.join(plan)}")
    manifest = json.loads(MANIFEST.read_text("utf-8")) if MANIFEST.exists() else {}
    for name in names or plan:
        if (variable := plan[name].get("data")) and not os.environ.get(variable):
            print(f"{name}: left as it is, for {variable} names no folder of its recordings", flush=True)
            continue
        manifest[name] = make_folder(name, plan[name])
        save_json(MANIFEST, manifest)
        print(f"{name}: {manifest[name]['minutes']} min at {manifest[name]['commit']}", flush=True)
    write_pages()


if __name__ == "__main__":
    main(*sys.argv[1:])
