"""What Ctrl-C and SIGTERM mean to a run."""

from __future__ import annotations

import signal
import threading
from collections.abc import Iterator
from contextlib import contextmanager

from bench.run.inbox import AbortRequested, Inbox, StopRequested

__all__ = ["ctrl_c_to"]


@contextmanager
def ctrl_c_to(inbox: Inbox) -> Iterator[None]:
    """Turn the first Ctrl-C into a stop after this cycle; the second, and SIGTERM, into an abort."""
    if threading.current_thread() is not threading.main_thread():
        yield
        return
    pressed = 0

    def on_signal(number: int, _frame: object) -> None:
        nonlocal pressed
        pressed += 1
        inbox.put(StopRequested() if pressed == 1 and number == signal.SIGINT else AbortRequested())

    before = {number: signal.signal(number, on_signal) for number in (signal.SIGINT, signal.SIGTERM)}
    try:
        yield
    finally:
        for number, handler in before.items():
            signal.signal(number, handler)
