"""The files that a run is in, open for reading: one, or the parts into which it was split."""

from __future__ import annotations

import os
import threading
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from pathlib import Path

from bench.errors import RecordingError
from bench.recording.files.output import active_path
from bench.recording.files.part_names import list_parts

__all__ = ["RunFiles", "opened"]

MOST_OPEN = 16
"""Parts that are open at once: a process may have 1024 files open, and a run a thousand parts."""


class RunFiles:
    """Reads at any place of any part, from any thread. Parts are opened when they are first read."""

    def __init__(self, paths: Sequence[Path]) -> None:
        self._paths = paths
        self._lock = threading.Lock()
        self._opened: dict[int, _Opened] = {}

    def pread(self, size: int, offset: int, part: int = 0) -> bytes:
        """Return up to `size` bytes from `offset` of a part, fewer at its end."""
        opened = self._opened.get(part) or self._open(part)  # held here, so that it is not closed while it is read
        return os.pread(opened.descriptor, size, offset)

    def size(self, part: int = 0) -> int:
        """Return how large a part is by now."""
        return os.fstat(self._open(part).descriptor).st_size

    def _open(self, part: int) -> _Opened:
        with self._lock:
            if part not in self._opened:
                if len(self._opened) >= MOST_OPEN:
                    del self._opened[next(iter(self._opened))]
                self._opened[part] = _Opened(_open(self._paths[part]))
            return self._opened[part]

    def close(self) -> None:
        self._opened.clear()


class _Opened:
    """A descriptor that is closed when the last reader has let go of it."""

    def __init__(self, descriptor: int) -> None:
        self.descriptor = descriptor

    def __del__(self) -> None:
        os.close(self.descriptor)


@contextmanager
def opened(*paths: Path) -> Iterator[RunFiles]:
    """Open the files of a run for reading; `RecordingError` says why they cannot be.

    A recording that its recorder has closed meanwhile is opened by its final name.
    """
    files, first = RunFiles(paths), paths[0]
    try:
        try:
            files.size()
        except OSError as error:
            hint = ""
            if active_path(first).exists():
                hint = f"Its recording was not closed, but {active_path(first)} can be read in its place."
            elif later := [path for found in list_parts(first).values() for path in found]:
                hint = f"{later[0]} is called like a later part of it, and can be read alone."
            raise RecordingError(f"{first} cannot be opened: {error.strerror}.", hint=hint) from error
        yield files
    except OSError as error:  # a folder, or a disk that fails
        raise RecordingError(f"{error.filename or first} cannot be read: {error.strerror}.") from error
    finally:
        files.close()


def _open(path: Path) -> int:
    try:
        return os.open(path, os.O_RDONLY)
    except FileNotFoundError:
        final = path.with_suffix("")
        if path != active_path(final) or not final.exists():
            raise
        return os.open(final, os.O_RDONLY)
