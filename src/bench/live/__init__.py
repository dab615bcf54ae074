"""The live view: a process of its own that follows the run file and serves it to Lichtblick and Foxglove."""

from __future__ import annotations

import threading
from collections.abc import Callable
from pathlib import Path

from bench.errors import ConfigError
from bench.recording import RunFollower

__all__ = ["serve_live"]


def serve_live(path: Path, host: str, port: int, stop: threading.Event, on_ready: Callable[[str], None]) -> None:
    """Follow the run file at `path`, which need not be there yet, and serve it until it is finished or `stop` is set.

    Parameters
    ----------
    path : Path
        The run file, by its final name or as ``x.mcap.active``.
    host, port : str, int
        Where viewers connect; port 0 is any free one.
    stop : threading.Event
    on_ready : callable
        Told the address once it is served.

    Raises
    ------
    ConfigError
        The library for it is not installed.
    ConnectError
        The address cannot be served.
    RecordingError
        The file cannot be read.
    """
    try:
        from bench.live.server import LiveServer
    except ImportError as error:
        raise ConfigError(
            f"The live view needs the library foxglove-sdk: {error}.",
            hint="Install it with: pip install 'cable-bench[live]'",
        ) from error
    from bench.live.view import show_run

    server = LiveServer(host, port)
    try:
        on_ready(server.url)
        show_run(RunFollower(path), server, stop)
    finally:
        server.close()
