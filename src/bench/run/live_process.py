"""Starts the live view as a process of its own, which follows the run file: it can cost the recorder nothing."""

from __future__ import annotations

import subprocess
import sys
import tempfile
from dataclasses import dataclass
from pathlib import Path

from bench.errors import BenchError, ConfigError, ConnectError
from bench.run.child import end_child, read_ready_lines

__all__ = ["LiveAddress", "LiveProcess"]

READY_WITHIN_S = 60.0
"""Machine time for imports and the port; 1 to 2 s on two slow cores, with room for a busy one."""
ENDS_WITHIN_S = 30.0
"""Machine time to show the last second."""


@dataclass(frozen=True, slots=True)
class LiveAddress:
    """Where the live view is served."""

    host: str = "127.0.0.1"
    port: int = 8765
    """The viewers' own default; 0 is any free one."""


class LiveProcess:
    """``bench live`` as a child process.

    Parameters
    ----------
    path : Path
        The run file, which need not be there yet.
    address : LiveAddress
    """

    def __init__(self, path: Path, address: LiveAddress) -> None:
        self._path = path
        self._address = address
        self._process: subprocess.Popen[bytes] | None = None

    def start(self) -> str:
        """Start the child and return its ready line.

        Raises
        ------
        ConfigError
            Its library is not installed.
        ConnectError
            The address cannot be served.
        """
        command = [sys.executable, "-m", "bench", "live", str(self._path), "--until-stdin-closes"]
        command += ["--host", self._address.host, "--port", str(self._address.port)]
        with tempfile.TemporaryFile(prefix="bench-live-") as stderr:
            self._process = subprocess.Popen(
                command, stdin=subprocess.PIPE, stdout=subprocess.PIPE, stderr=stderr, start_new_session=True
            )
            lines = read_ready_lines(self._process, 1, READY_WITHIN_S)
            if not lines:
                code = end_child(self._process, ENDS_WITHIN_S)
                stderr.seek(0)
                raise _explain(code, stderr.read().decode("utf-8", "replace").strip())
        return lines[0]

    def close(self) -> None:
        """End the child when the run file is closed; it shows what is left. May be called twice."""
        process, self._process = self._process, None
        if process is not None:
            end_child(process, ENDS_WITHIN_S)


def _explain(code: int, said: str) -> BenchError:
    kind = ConfigError if code == ConfigError.exit_code else ConnectError
    return kind(said.removeprefix("error: ") or "The live view did not start, and did not say why.")
