"""Work in two steps: the first on several items at once, the second on one after the other, in order.

Meant for a first step that hardly holds the interpreter's lock, as unpacking, beside a second that mostly does. One
thread does both for its item: so it finds in its own core's cache what it has prepared, and wherever the longer step
is, two cores are busy.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from typing import TypeVar

__all__ = ["work_in_turn"]

N_THREADS = 2
"""More would wait for their turn: the second step is nearly half of the work."""
AHEAD = 16
"""Items that are begun at most. Half of them are waited for at once: who wakes up for each stops one who works."""

_Item = TypeVar("_Item")
_Prepared = TypeVar("_Prepared")
_Done = TypeVar("_Done")


def work_in_turn(
    items: Iterable[_Item], prepare: Callable[[_Item], _Prepared], finish: Callable[[_Prepared], _Done]
) -> Iterator[_Done]:
    """Yield what `finish` returns of each prepared item; what one of the two raises ends it."""

    def work(item: _Item, before: Future[_Done] | None) -> _Done:
        prepared = prepare(item)
        if before is not None:
            before.result()  # has begun earlier, so it does not wait for this one
        return finish(prepared)

    with ThreadPoolExecutor(N_THREADS, "reading") as threads:
        begun: deque[Future[_Done]] = deque()
        for item in items:
            begun.append(threads.submit(work, item, begun[-1] if begun else None))
            if len(begun) == AHEAD:
                begun[AHEAD // 2].result()
                while begun and begun[0].done():
                    yield begun.popleft().result()
        while begun:
            yield begun.popleft().result()
