"""Two things at once: making items, and working on those already made."""

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

Item = TypeVar("Item")
Result = TypeVar("Result")
AHEAD = 4  # items that may wait: more would only fill memory


def overlapped(items: Iterable[Item], work: Callable[[Item], Result]) -> Iterator[Result]:
    """``work`` of each item, in order, done in one other thread while this one makes the next item.

    It pays where both leave Python's lock alone, as OpenCV does. Errors of either come out here.
    """
    with ThreadPoolExecutor(max_workers=1) as worker:
        pending: deque[Future[Result]] = deque()
        for item in items:
            pending.append(worker.submit(work, item))
            if len(pending) > AHEAD:
                yield pending.popleft().result()
        while pending:
            yield pending.popleft().result()
