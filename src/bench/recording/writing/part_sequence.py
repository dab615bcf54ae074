"""The file that a run is written into, and those in which it goes on when one is full."""

from __future__ import annotations

import logging
from collections.abc import Mapping, Sequence
from contextlib import suppress
from pathlib import Path

from bench.errors import DiskFullError, RecordingError, RecordingExistsError
from bench.recording.files.output import explained, verify_absent
from bench.recording.files.part_names import FIRST_NUMBER, PART, list_parts, part_path
from bench.recording.writing.descriptions import describe_part
from bench.recording.writing.part_writing import Attachment, PartEnding, RunPart

__all__ = ["PartSequence"]

_NEVER = 1 << 62

_log = logging.getLogger(__name__)


class PartSequence:
    """Writes one part after the other; each says again all that stands outside of the records.

    Parameters
    ----------
    path : Path
        The first part's final name.
    split_bytes : int
        Size from which on a part is full; 0: never.
    notes : mapping
        Metadata records by name.
    attachments : sequence of Attachment

    Raises
    ------
    RecordingExistsError
        A name is taken.
    RecordingError
        The folder or the file cannot be written.
    """

    def __init__(
        self,
        path: Path,
        split_bytes: int,
        notes: Mapping[str, Mapping[str, str]],
        attachments: Sequence[Attachment],
    ) -> None:
        self._first = path
        self._split_bytes = split_bytes or _NEVER
        self._said = {name: dict(values) for name, values in notes.items()}
        self._attachments = attachments
        self._ending: PartEnding | None = None
        self._displaced: RecordingExistsError | None = None
        if split_bytes:
            _verify_names_free(path)
            self._said[PART] = describe_part(path, FIRST_NUMBER, 0)
        with explained(path):
            self._part = RunPart(path, self._said, attachments)
            self._make_durable()
        self._parts = [self._part]
        self._split_at = self._find_end()

    def _find_end(self) -> int:
        """Return the size at which the part ends: what each part repeats is never most of it."""
        return max(self._split_bytes, 2 * self._part.size)

    def _make_durable(self) -> None:
        try:
            self._part.sync()
            self._part.file.sync_folder()
        except BaseException:
            self._part.file.discard()
            raise

    @property
    def paths(self) -> list[Path]:
        """The final names of all parts so far."""
        return [part.file.path for part in list(self._parts)]

    @property
    def size(self) -> int:
        """Bytes in all parts so far."""
        return sum(part.size for part in list(self._parts))

    @property
    def active(self) -> Path:
        """The file that is being written."""
        return self._part.file.active

    def free_bytes(self) -> int:
        return self._part.file.free_bytes()

    @property
    def is_full(self) -> bool:
        """The part under way has reached the size at which the run goes on in the next."""
        return self._part.size >= self._split_at

    def split_no_more(self) -> None:
        """Let the part under way be the last."""
        self._split_at = _NEVER

    def add_message(self, topic: str, log_time_ns: int, payload: bytes, publish_time_ns: int, number: int) -> None:
        self._part.add_message(topic, log_time_ns, payload, publish_time_ns, number)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        """Write a metadata record, here and at the beginning of each part that is still to come."""
        self._part.add_metadata(name, values)
        self._said[name] = self._said.get(name, {}) | dict(values)

    def end_chunk(self) -> None:
        self._part.end_chunk()

    def sync(self) -> None:
        self._part.sync()

    def go_on(self, totals: Mapping[str, str], n_written: int) -> str:
        """Begin the next part. All that was added before is on the disk; the part before gets its end meanwhile.

        Parameters
        ----------
        totals : mapping
            What became of the records so far.
        n_written : int
            Messages so far.

        Returns
        -------
        str
            Why the next part cannot be created, so that what follows goes into this one; empty if it is.

        Raises
        ------
        DiskFullError, RecordingError
            The disk cannot take it, or the part before did not get its end.
        """
        self._await_ending()
        number = len(self._parts) + 1
        path = part_path(self._first, number)
        notes = self._said | {PART: describe_part(self._first, number, n_written)}
        try:
            with explained(path):
                following = RunPart(path, notes, self._attachments)
        except DiskFullError:
            raise
        except RecordingError as error:
            self._split_at = self._part.size + self._split_bytes
            return f"The recording could not be split, so it goes on in {self.active}: {error}"
        self._ending = PartEnding(self._part, following, {"file": path.name} | dict(totals))
        self._part = following
        self._parts.append(following)
        self._split_at = self._find_end()
        return ""

    def verify_ending(self) -> None:
        """Raise what kept the part before from its end, if that is known by now; see `go_on`."""
        if self._ending is not None and self._ending.is_over:
            self._await_ending()

    def _await_ending(self) -> None:
        ending, self._ending = self._ending, None
        if ending is None:
            return
        try:
            ending.wait()
        except RecordingExistsError as error:  # complete, but under its active name
            self._displaced = error
            _log.warning("%s", error)

    def finish(self, values: Mapping[str, str]) -> None:
        """Write ``bench.end`` and end the last part.

        Raises
        ------
        RecordingExistsError
            The final name of a part was taken meanwhile; the part is complete under its active name.
        RecordingError, OSError
            The disk or the folder does not take it.
        """
        self._await_ending()
        self._part.finish("bench.end", values)
        if self._displaced is not None:
            raise self._displaced

    def close(self) -> None:
        """Close without publishing: what is readable stays under its active name."""
        with suppress(RecordingError):
            self._await_ending()
        self._part.file.close()

    def discard(self) -> None:
        """Delete every part: for a run that never began."""
        self.close()
        for part in self._parts:
            part.file.discard()


def _verify_names_free(first: Path) -> None:
    for paths in list_parts(first).values():
        for path in paths:
            verify_absent(path, "A later part of this run would have that name. ")
