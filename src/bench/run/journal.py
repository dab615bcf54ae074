"""Where a run is, line by line on the disk: so that a bench that was killed knows it.

The run file itself is synced once a second; a journal line is on the disk before the next cycle is granted.
"""

from __future__ import annotations

import fcntl
import json
import logging
import os
from collections.abc import Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path

from bench.model import StateChange
from bench.recording import final_path, find_first

__all__ = ["Journal", "is_held", "journal_path", "read_completed"]

_log = logging.getLogger(__name__)


def journal_path(run_file: Path) -> Path:
    """Return the journal of a run file: ``x.mcap.journal`` of ``x.mcap`` and of ``x.mcap.active``."""
    return run_file.with_name(f"{final_path(run_file).name}.journal")


class Journal:
    """The journal of one run, JSON lines. Locked while the run lives; removed when its file is finished.

    A disk that does not take it ends no run: the run file is what counts, and says so itself.

    Parameters
    ----------
    run_file : Path
        The run file's final name.
    facts : mapping
        First line: run id, hash of the configuration, cycles wanted and done before.
    """

    def __init__(self, run_file: Path, facts: Mapping[str, object]) -> None:
        self._path = journal_path(run_file)
        self._n_completed = -1
        self._descriptor = -1
        with _tolerated(self._path):
            self._descriptor = os.open(self._path, os.O_WRONLY | os.O_CREAT | os.O_TRUNC | os.O_APPEND, 0o644)
            fcntl.flock(self._descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
        self._write(dict(facts))

    def note_completed(self, n_completed: int) -> None:
        """Note how many cycles are completed, if that is news."""
        if n_completed != self._n_completed:
            self._n_completed = n_completed
            self._write({"completed": n_completed})

    def note_state(self, change: StateChange) -> None:
        """Note that the run went to another state."""
        self._write({"state": str(change.state), "reason": change.reason, "host_ns": change.host_ns})

    def close(self, *, remove: bool) -> None:
        """Let go of the journal; `remove`: there is a finished run file in its place."""
        descriptor, self._descriptor = self._descriptor, -1
        if descriptor < 0:
            return
        with _tolerated(self._path):
            if remove:
                self._path.unlink()
        os.close(descriptor)

    def _write(self, line: Mapping[str, object]) -> None:
        if self._descriptor < 0:
            return
        with _tolerated(self._path):
            os.write(self._descriptor, (json.dumps(line) + "\n").encode())
            os.fdatasync(self._descriptor)


@contextmanager
def _tolerated(path: Path) -> Iterator[None]:
    try:
        yield
    except OSError as error:
        _log.warning("the journal %s cannot be written: %s", path, error)


def is_held(run_file: Path) -> bool:
    """Tell whether a bench that lives is writing this run file, or the run of which it is a later part."""
    first = find_first(run_file)
    return _is_locked(journal_path(run_file)) or (first is not None and _is_locked(journal_path(first)))


def _is_locked(journal: Path) -> bool:
    try:
        descriptor = os.open(journal, os.O_RDONLY)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(descriptor)
    return False


def read_completed(run_file: Path) -> int:
    """Return how many cycles the journal of a run file says were completed; 0 without one."""
    try:
        text = journal_path(run_file).read_text(encoding="utf-8", errors="replace")
    except OSError:
        return 0
    return max((_read_line(line) for line in text.splitlines()), default=0)


def _read_line(line: str) -> int:
    try:
        values = json.loads(line)
    except ValueError:  # the last line of a power cut
        return 0
    count = values.get("completed", 0) if isinstance(values, dict) else 0
    return count if isinstance(count, int) else 0
