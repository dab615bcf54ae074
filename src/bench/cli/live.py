"""``bench live``."""

from __future__ import annotations

import os
import signal
import sys
import threading
from pathlib import Path
from typing import Annotated

import typer

from bench.errors import RecordingError

__all__ = ["live"]

POLITENESS = 10
"""Of 19: a picture may wait, the bench beside it may not."""


def live(
    path: Annotated[Path, typer.Argument(metavar="RUN.mcap.active", help="The file of a run that is under way.")],
    host: Annotated[str, typer.Option("--host", help="Address to serve; others than loopback are open to all.")] = (
        "127.0.0.1"
    ),
    port: Annotated[int, typer.Option("--port", min=0, max=65535, help="TCP port; 0 is any free one.")] = 8765,
    until_stdin_closes: Annotated[bool, typer.Option("--until-stdin-closes", hidden=True)] = False,
) -> None:
    """Serve a run that is under way to Lichtblick or Foxglove, from its file alone. Ends with the run, or by Ctrl-C."""
    from bench.live import serve_live

    stop = threading.Event()
    for number in (signal.SIGINT, signal.SIGTERM):
        signal.signal(number, lambda *_: stop.set())
    if until_stdin_closes:
        threading.Thread(target=_stop_at_end_of_input, args=(stop,), name="stdin", daemon=True).start()
    else:
        _verify_growing(path)
    os.nice(POLITENESS)
    serve_live(path, host, port, stop, lambda url: print(f"ready live {url}", flush=True))


def _verify_growing(path: Path) -> None:
    if not path.exists():
        raise RecordingError(
            f"{path} cannot be opened: there is no such file.",
            hint="The file of a run that is under way ends in .active.",
        )
    if path.suffix not in (".mcap", ".active"):
        raise RecordingError(
            f"{path} is no run file.", hint="The file of a run that is under way ends in .mcap.active."
        )
    if path.suffix != ".active":
        raise RecordingError(
            f"{path} is finished: there is nothing to follow.", hint="Open the file itself in Lichtblick or Foxglove."
        )


def _stop_at_end_of_input(stop: threading.Event) -> None:
    # the parent holds the other end open as long as it lives; a killed parent closes it too
    while os.read(sys.stdin.fileno(), 4096):
        pass
    stop.set()
