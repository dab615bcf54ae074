"""One file of a run while it is written: all of the run, or a part of a run that is split by size."""

from __future__ import annotations

import threading
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any, NamedTuple

from mcap.writer import CompressionType, Writer

from bench.recording.files.output import OutputFile, explained
from bench.recording.files.part_names import CONTINUES
from bench.recording.messages.schemas import load_schema
from bench.recording.messages.topics import TOPICS

__all__ = ["FORMAT_VERSION", "Attachment", "PartEnding", "RunPart"]

FORMAT_VERSION = "1"
"""Of the run file as a whole: topics, metadata, meanings. The message definitions travel in the file itself."""
_NEVER = 1 << 62


class Attachment(NamedTuple):
    """A file that travels in each part."""

    time_ns: int
    name: str
    content: str | bytes
    """A TOML text, or bytes of any kind."""


class RunPart:
    """A complete MCAP file that any reader opens by itself. What is written is durable after `sync`.

    Parameters
    ----------
    path : Path
        Its final name; until `finish` it is called ``<path>.active``.
    notes : mapping
        Metadata records by name.
    attachments : iterable of Attachment

    Raises
    ------
    RecordingExistsError
        `path` or its active name exists.
    RecordingError, OSError
        The folder or the file cannot be written; nothing is left of it.
    """

    def __init__(
        self, path: Path, notes: Mapping[str, Mapping[str, str]], attachments: Iterable[Attachment] = ()
    ) -> None:
        self.file = OutputFile(path)
        self.size = 0
        """Bytes in the file, up to the end of the last chunk."""
        try:
            self._mcap = self._open_mcap()
            # the channels repeat what stands in the first chunk, so that losing that does not cost the others
            self.add_metadata("bench.channels", {str(key): topic for topic, key in self._channels.items()})
            for name, values in notes.items():
                self.add_metadata(name, values)
            for one in attachments:
                self._attach(one)
            self.end_chunk()
        except BaseException:
            self.file.discard()
            raise

    def _open_mcap(self) -> Any:
        # chunks end between records, never inside one: a frame's points and its description cannot be parted
        writer: Any = Writer(self.file.stream, chunk_size=_NEVER, compression=CompressionType.LZ4)
        writer.start(profile="ros2", library=f"bench recording {FORMAT_VERSION}")
        self._channels: dict[str, int] = {}
        for topic in TOPICS.values():
            schema_id = writer.register_schema(topic.schema, "ros2msg", load_schema(topic.schema).text.encode())
            self._channels[topic.name] = writer.register_channel(topic.name, "cdr", schema_id)
        return writer

    def _attach(self, one: Attachment) -> None:
        if isinstance(one.content, str):
            kind, data = "application/toml", one.content.encode()
        else:
            kind, data = "application/octet-stream", one.content
        self._mcap.add_attachment(one.time_ns, one.time_ns, one.name, kind, data)

    def add_message(self, topic: str, log_time_ns: int, payload: bytes, publish_time_ns: int, number: int) -> None:
        self._mcap.add_message(self._channels[topic], log_time_ns, payload, publish_time_ns, number)

    def add_metadata(self, name: str, values: Mapping[str, str]) -> None:
        self._mcap.add_metadata(name, dict(values))

    def end_chunk(self) -> None:
        """End the chunk in progress; what was added is then the system's, and survives the process."""
        self._mcap.flush()
        self.size = self.file.stream.tell()

    def sync(self) -> None:
        """Return when everything up to the last chunk is on the disk."""
        self.file.sync()

    def finish(self, name: str, values: Mapping[str, str]) -> None:
        """Write a last metadata record and the summary, make the file durable and give it its final name.

        Raises
        ------
        RecordingExistsError
            The final name was taken meanwhile; the complete file keeps its active name.
        OSError
            The disk or the folder does not take it.
        """
        self.add_metadata(name, values)
        self._mcap.finish()
        self.file.sync()
        self.size = self.file.stream.tell()
        self._mcap = None  # with the places of all its chunks
        self.file.publish()


class PartEnding:
    """Ends a part in a thread of its own, while the next one is filled: a disk takes its time for each of the steps.

    The next one is made durable first, name and all: a crash between two steps leaves files that can all be read.
    """

    def __init__(self, part: RunPart, following: RunPart, values: Mapping[str, str]) -> None:
        self._part = part
        self._following = following
        self._values = values
        self._error: Exception | None = None
        self._thread = threading.Thread(target=self._end, name="recorder-part", daemon=True)
        self._thread.start()

    @property
    def is_over(self) -> bool:
        return not self._thread.is_alive()

    def wait(self) -> None:
        """Return when the part has its end; raise the `RecordingError` that says what kept it from it."""
        self._thread.join()
        if self._error is not None:
            raise self._error

    def _end(self) -> None:
        try:
            with explained(self._part.file.active):
                self._following.sync()
                self._following.file.sync_folder()
                self._part.finish(CONTINUES, self._values)
        except Exception as error:  # whatever it is, it is raised where it is waited for
            self._error = error
        finally:
            self._part.file.close()
