"""A run file while it is being written: what its recorder has added, chunk by chunk. The file is only read."""

from __future__ import annotations

from collections import deque
from dataclasses import replace
from pathlib import Path, PurePath

from bench.errors import RecordingError
from bench.recording.container.contents import MAGIC, Chunk, Container
from bench.recording.container.scanning import scan_further
from bench.recording.files.output import active_path
from bench.recording.files.part_names import CONTINUES
from bench.recording.files.run_files import RunFiles, opened
from bench.recording.reading.reader import Run

__all__ = ["RunFollower"]

RECENT_CHUNKS = 30
"""Half a minute: the recorder ends a chunk each second."""


class RunFollower:
    """Reads what a recorder adds to a run, from where it left off.

    Nothing is locked and no file stays open. The name that the recorder gives the file at its end is followed, and so
    is a run that goes on in another part.

    Parameters
    ----------
    path : Path
        The run file's final name, or ``x.mcap.active``. It need not be there yet. Of a run that was split, the part
        from which on it is followed.
    """

    def __init__(self, path: Path) -> None:
        self._paths = [path if path.suffix == ".active" else active_path(path)]
        self._recent: deque[Chunk] = deque(maxlen=RECENT_CHUNKS)
        self._begin_part()

    def _begin_part(self) -> None:
        self._found = Container(size=0, end=len(MAGIC))
        self._has_begun = False

    @property
    def is_finished(self) -> bool:
        """The recorder has closed the file, and all of it was read."""
        return self._found.finished and CONTINUES not in self._found.metadata

    def read(self) -> Run | None:
        """Return what was added since the last call, as a run of its own; None if nothing was.

        Raises
        ------
        RecordingError
            The file cannot be read, or is none of ours.
        """
        if self._found.finished and not self.is_finished:
            name = self._found.metadata[CONTINUES].get("file", "")
            self._paths.append(active_path(self._paths[0].with_name(PurePath(name).name)))
            self._begin_part()
        path = self._paths[-1]
        if not self._has_begun and not path.exists() and not path.with_suffix("").exists():
            return None
        with opened(path) as file:
            self._has_begun = self._has_begun or self._begins(file, path)
            if self._has_begun:
                scan_further(file, self._found)
        added, self._found.chunks = self._found.chunks, []
        for chunk in added:
            chunk.part = len(self._paths) - 1
        self._recent.extend(added)
        return self._run_of(added) if added else None

    def _begins(self, file: RunFiles, path: Path) -> bool:
        first = file.pread(len(MAGIC), 0)
        if first != MAGIC[: len(first)]:
            raise RecordingError(f"{path} is not an MCAP file.")
        return first == MAGIC

    def recent(self) -> Run:
        """Return the newest chunks that were read, at most `RECENT_CHUNKS`, as a run of their own."""
        return self._run_of(list(self._recent))

    def _run_of(self, chunks: list[Chunk]) -> Run:
        return Run(self._paths, replace(self._found, chunks=chunks))
