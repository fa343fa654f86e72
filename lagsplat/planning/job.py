"""One job of the workflow: the only module that knows Snakemake.

A script does ``with Job(snakemake) as job:`` and calls the library. The job sets threads and seeds, keeps
the rule's log, and on success leaves the record of what was run beside the results. It holds the lease of
what it makes and ends with Snakemake, so nothing has two writers. Progress goes to stderr; a failure is one
line there, with the traceback in the log.
"""

import hashlib
import json
import logging
import os
import subprocess
import sys
import time
from contextlib import ExitStack
from pathlib import Path
from types import TracebackType
from typing import Any, Self, TypeVar

from lagsplat.config.compose import rebuild
from lagsplat.io.files.atomic import save_json, sha256_of
from lagsplat.io.files.lease import hold_lease
from lagsplat.io.files.tracking import read_curve, read_scores, track
from lagsplat.planning.plan import read_overrides, shared_experiment
from lagsplat.processes import end_with_driver, ends_with_this_process
from lagsplat.project import find_project
from lagsplat.provenance import seed_everything, set_threads, stamp

Section = TypeVar("Section")
log = logging.getLogger(__name__)


class Job:
    """What a workflow script is given, and the frame it runs in.

    ``input``, ``output``, ``params``, ``wildcards`` and ``threads`` are Snakemake's own. ``seed`` is the last
    seed in the path, or 0.
    """

    def __init__(self, snakemake: Any) -> None:
        self.rule: str = snakemake.rule
        self.input, self.output = snakemake.input, snakemake.output
        self.params, self.wildcards = snakemake.params, snakemake.wildcards
        self.threads: int = snakemake.threads
        self.log_file = str(snakemake.log[0])
        self.command_line: dict[str, Any] = dict(getattr(snakemake, "config", {}))
        names: dict[str, str] = dict(self.wildcards.items())
        self.seed = int(names.get("seed", names.get("ae", "0")))
        self.started = time.monotonic()
        self.lease = ExitStack()

    def __enter__(self) -> Self:
        end_with_driver()
        try:
            self.lease.enter_context(hold_lease(self.output[0]))
        except OSError as error:  # before the log, which belongs to the other job
            sys.exit(f"{self.rule}: {error}")
        handler = logging.FileHandler(self.log_file, mode="w", encoding="utf-8")
        handler.setFormatter(logging.Formatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
        logging.basicConfig(level=logging.INFO, handlers=[handler], force=True)
        logging.captureWarnings(True)
        if "torch" in sys.modules:  # a table needs neither torch nor the seconds it takes to load
            set_threads(self.threads)
            seed_everything(self.seed)
        log.info("%s %s, %d threads", self.rule, dict(self.wildcards.items()), self.threads)
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        with self.lease:  # until the record is there
            seconds = time.monotonic() - self.started
            if error is not None:
                log.error("%s failed after %.1f s", self.rule, seconds, exc_info=error)
                if isinstance(error, Exception):
                    sys.exit(f"{self.rule}: {error} (traceback: {self.log_file})")
                return
            if record := dict(self.output.items()).get("record"):
                save_json(record, {**self.header, "stamp": stamp(), "wall_s": seconds})
            self._track_metrics()
            log.info("%s done in %.1f s", self.rule, seconds)

    def _track_metrics(self) -> None:
        """Keep the curve or the scores that this job has written where the experiment says."""
        outputs = dict(self.output.items())
        for name, read in (("curve", read_curve), ("metrics", read_scores)):
            if path := outputs.get(name):
                kind = shared_experiment(read_overrides(self.command_line)).tracking
                place, settings = str(Path(path).parent), {"seed": self.seed, **self.header["settings"]}
                try:
                    track(kind, read(path), run=place, rule=self.rule, settings=settings)
                except Exception as error:  # of whatever kind a store raises: the result itself is there
                    self.say(f"tracking={kind}: the metrics were not kept: {error}")

    def section(self, schema: type[Section], name: str = "cfg") -> Section:
        """A slice of the configuration that the rule carries as a parameter, typed and checked."""
        return rebuild(schema, self.params[name])

    def choice(self, schema: type[Section], name: str) -> Section | None:
        """The same for a slice that may be null."""
        return None if self.params[name] is None else self.section(schema, name)

    def title(self, what: str) -> str:
        """The caption line of a figure: what, of which system, from which recording and profile."""
        path = self.wildcards
        return f"{what} · {self.params.title} · {path.recording} recording · profile {path.profile}"

    def say(self, what: object) -> None:
        """Tell the screen and the log."""
        log.info("%s", what)
        print(f"{self.rule}: {what}", file=sys.stderr)

    def command(self, module: str, *words: object) -> str:
        """Run ``python -m module words`` of the pipeline's own ``benchmarks``; returns what it printed.

        Raises:
            RuntimeError: it failed; its last words are in the message, all of them in the log.
        """
        root = str(find_project())
        done = subprocess.run(
            [sys.executable, "-m", module, *map(str, words)],
            env={**os.environ, "PYTHONPATH": os.pathsep.join([root, os.environ.get("PYTHONPATH", "")])},
            capture_output=True,
            text=True,
            check=False,
            **ends_with_this_process(),
        )
        log.info("%s\n%s%s", module, done.stdout, done.stderr)
        if done.returncode:
            raise RuntimeError(f"{module} failed: {(done.stderr.strip() or 'no reason given')[-600:]}")
        return done.stdout

    @property
    def header(self) -> dict[str, Any]:
        """What made the results, for their headers: rule, identity, settings, code and threads."""
        return {
            "rule": self.rule,
            "wildcards": dict(self.wildcards.items()),
            "settings": dict(self.params.items()),
            "seed": self.seed,
            "threads": self.threads,
        }

    @property
    def identity(self) -> str:
        """Digest of all that decides the outcome: settings, code, seed and the content of the inputs."""
        inputs = {name: sha256_of(path) for name, path in self.input.items() if path and name != "records"}
        parts = [dict(self.params.items()), self.seed, inputs]
        return hashlib.sha256(json.dumps(parts, sort_keys=True).encode()).hexdigest()
