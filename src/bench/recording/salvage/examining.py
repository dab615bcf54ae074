"""Every part of a file looked at, before any of it is kept: what is sound, and what is not."""

from __future__ import annotations

from dataclasses import dataclass
from operator import attrgetter
from pathlib import Path

from mcap import records

from bench.errors import RecordingUnfinishedError
from bench.recording.container.chunks import count_messages, has_sound_index, read_chunk
from bench.recording.container.contents import (
    ATTACHMENT,
    HEAD,
    METADATA,
    Chunk,
    Container,
    DamagedError,
    Note,
    describe_chunk,
)
from bench.recording.container.notes import read_note
from bench.recording.files.part_names import CONTINUES, FIRST_NUMBER, read_number
from bench.recording.files.run_files import RunFiles
from bench.recording.messages.schemas import load_schema
from bench.recording.messages.topics import TOPICS

__all__ = ["Examined", "define_topics", "examine"]

DATA_END_SIZE = HEAD.size + 4


@dataclass(slots=True)
class Examined:
    """A file of which every part has been looked at."""

    path: Path
    container: Container
    chunks: list[Chunk]
    """Those that are sound."""
    notes: list[Note]
    """Metadata and attachments that are sound."""
    lost: list[str]
    is_followed: bool
    """The next part of its run is there: the recorder had written all of this one before it began that."""

    @property
    def was_complete(self) -> bool:
        """The file had its end, and no damage."""
        return self.container.finished and not self.lost

    @property
    def is_closed(self) -> bool:
        """The recorder had written all of it."""
        told = self.container.metadata
        return self.is_followed or "bench.end" in told or CONTINUES in told or "bench.run" not in told

    @property
    def parts(self) -> list[Chunk | Note]:
        """All that is kept, in the order of the file."""
        return sorted([*self.chunks, *self.notes], key=attrgetter("start"))

    @property
    def data_end(self) -> int:
        """Where the last sound chunk ends, or in a file without any the last note."""
        return (self.chunks or self.notes)[-1].end


def examine(file: RunFiles, path: Path, container: Container, *, is_followed: bool = False) -> Examined:
    """Hold every chunk of a file against its checksum and read every note.

    Raises
    ------
    RecordingUnfinishedError
        There is nothing in it that could be kept.
    """
    defined = {channel.id for channel in define_topics(container)[1]}
    chunks = [chunk for chunk in container.chunks if _is_sound(file, chunk, container, defined)]
    notes = [note for note in container.notes if _is_kept(file, note, container)]
    lost = [*container.damage, *_describe_rest(container)]
    # a later part begins before there is a record for it
    may_be_empty = (container.finished and not lost) or (notes and read_number(container.metadata) != FIRST_NUMBER)
    if not chunks and not may_be_empty:
        reason = f": {lost[0]}" if lost else ""
        raise RecordingUnfinishedError(f"{path} holds no whole record that could be kept{reason}.")
    return Examined(path, container, chunks, notes, lost, is_followed)


def _is_sound(file: RunFiles, chunk: Chunk, container: Container, defined: set[int]) -> bool:
    try:
        data = read_chunk(file, chunk)
        if not has_sound_index(file, chunk, data):
            chunk.index.clear()
            chunk.counts = count_messages(data)
        _verify_defined(chunk, defined)
    except DamagedError as error:
        container.note_damage(chunk.offset, f"{describe_chunk(chunk, container)}: {error}")
        return False
    return True


def _verify_defined(chunk: Chunk, defined: set[int]) -> None:
    unknown = sorted(chunk.counts.keys() - defined)
    if unknown:
        raise DamagedError(f"nothing in the file says what its channels are: {', '.join(map(str, unknown))}")


def _is_kept(file: RunFiles, note: Note, container: Container) -> bool:
    if note.opcode not in {METADATA, ATTACHMENT}:
        return False
    try:
        read_note(file, note)
    except DamagedError as error:
        kind = "metadata" if note.opcode == METADATA else "an attachment"
        container.note_damage(note.start, f"{note.end - note.start} bytes of {kind} at byte {note.start}: {error}")
        return False
    return True


def _describe_rest(container: Container) -> list[str]:
    n_bytes = container.size - container.end
    # a summary that was cut off can be made again; what follows a run's end is the record that begins it
    is_closed = "bench.end" in container.metadata or CONTINUES in container.metadata
    in_summary = container.data_ended or (is_closed and n_bytes < DATA_END_SIZE)
    if container.finished or in_summary or not n_bytes:
        return []
    return [f"{n_bytes} bytes from byte {container.end} on: {container.problem}"]


def define_topics(container: Container) -> tuple[list[records.Schema], list[records.Channel]]:
    """Return all definitions; those that were lost with their chunk are this version's own."""
    schemas = dict(container.schemas)
    channels = {key: c for key, c in container.registered.items() if c.schema_id == 0 or c.schema_id in schemas}
    for key, channel in container.channels.items():
        if key not in channels and channel.topic in TOPICS:
            name = TOPICS[channel.topic].schema
            number = max(schemas, default=0) + 1
            schemas[number] = records.Schema(
                id=number, name=name, encoding="ros2msg", data=load_schema(name).text.encode()
            )
            channels[key] = records.Channel(key, channel.topic, "cdr", {}, number)
    return list(schemas.values()), list(channels.values())
