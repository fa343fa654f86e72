"""Results of the long steps of a fit, kept on disk: a fit that was stopped goes on after the last of them.

A fit is a sequence of steps, each a function of what came before. One that starts again repeats what is quick
and takes the results of the long steps from the checkpoint, in their order, so it ends with the same bits.
"""

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Any

from lagsplat.io.files.checkpoint import load_checkpoint, save_checkpoint

Result = dict[str, Any]  # tensors, numbers and text
Recall = Callable[[Callable[[], Result]], Result]
"""Takes a step and returns its result, which it may know already."""
log = logging.getLogger(__name__)


def solve_anew(solve: Callable[[], Result]) -> Result:
    """The `Recall` that knows nothing."""
    return solve()


class FinishedFits:
    """The `Recall` of one fit: results are kept in the file ``path``, which belongs to ``identity``."""

    def __init__(self, path: Path, *, identity: str) -> None:
        state = load_checkpoint(path, identity=identity)
        self.path, self.identity = path, identity
        self.results: list[Result] = [] if state is None else state["results"]
        self.taken = 0
        if self.results:
            log.info("going on from %s after %d finished fits", path, len(self.results))

    def __call__(self, solve: Callable[[], Result]) -> Result:
        """The result of the next step: the one that is kept, or a new one, which is kept from then on."""
        if self.taken == len(self.results):
            self.results.append(solve())
            save_checkpoint(self.path, {"results": self.results}, identity=self.identity)
        self.taken += 1
        return self.results[self.taken - 1]
