"""Compiled functions side by side in threads.

Numba's own parallel loops link all that a loop calls into each of three modules and optimise it in every one,
which takes most of a minute for a rollout.
"""

import os
from collections.abc import Callable
from concurrent.futures import ThreadPoolExecutor
from functools import cache

import numba
import numpy as np


def run_in_threads(function: Callable[[np.ndarray], None], n_jobs: int, together: int = 1) -> None:
    """Call ``function`` with the numbers below ``n_jobs``, some at a time.

    Args:
        function: does the jobs whose numbers (R,) it gets, mostly without holding Python's lock.
        n_jobs: number of jobs.
        together: how many of them a call gets.
    """
    parts = [np.arange(i, min(i + together, n_jobs)) for i in range(0, n_jobs, together)]
    if (threads := numba.get_num_threads()) > 1 and len(parts) > 1:
        list(_pool(threads, os.getpid()).map(function, parts))
    else:
        for part in parts:
            function(part)


@cache
def _pool(threads: int, process: int) -> ThreadPoolExecutor:
    """The threads of this process: a fork has none of those that were there."""
    return ThreadPoolExecutor(threads)
