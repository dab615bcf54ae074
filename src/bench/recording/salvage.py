"""Making a sound file of an unfinished or damaged one: every whole record is kept, byte for byte, and nothing else.

A copy takes what is sound and leaves the rest out. In place a file is only finished: what was cut off at its end is
taken away and the missing summary is written, so that the work does not grow with what it holds. Before either, every
chunk is unpacked and held against its checksum.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Iterator
from dataclasses import dataclass, replace
from io import BytesIO
from operator import attrgetter
from pathlib import Path

import lz4.frame
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError

from bench.errors import RecordingError, RecordingExistsError, RecordingUnfinishedError
from bench.recording.chunks import count_messages, has_sound_index, index_messages, read_chunk
from bench.recording.container import (
    ATTACHMENT,
    HEAD,
    INDEX_HEAD,
    MAGIC,
    METADATA,
    Chunk,
    Container,
    DamagedError,
    Note,
    describe_chunk,
)
from bench.recording.ending import Ending, encode_records
from bench.recording.loading import opened
from bench.recording.notes import read_note
from bench.recording.output import OutputFile, explained, rename_new
from bench.recording.reader import LAST_SECOND, SALVAGE
from bench.recording.scanning import scan_container
from bench.recording.schemas import load_schema
from bench.recording.topics import TOPICS

__all__ = ["Salvaged", "salvage_copy", "salvage_in_place"]

_HEADER = 1
DATA_END_SIZE = HEAD.size + 4
LARGEST_HEADER = 4096
"""Bytes of the file's header record: two short names."""


@dataclass(frozen=True, slots=True)
class Salvaged:
    """What was kept of a file, and what was not."""

    path: Path
    """Where it is now."""
    topics: dict[str, int]
    """Messages kept, by topic."""
    lost: tuple[str, ...]
    """What stood in the file and could not be kept; one sentence for each part."""
    is_closed: bool
    """Its recorder had come to the end of the run. Otherwise about the last second never reached the file."""
    was_complete: bool
    """The file had its end, and no damage."""


def salvage_copy(source: Path, output: Path) -> Salvaged:
    """Write all that is sound in `source` into a new file.

    Raises
    ------
    RecordingUnfinishedError
        There is nothing in it that could be kept; no file is written.
    RecordingExistsError
        `output` exists.
    RecordingError, DiskFullError
        `source` cannot be read, or `output` not be written.
    """
    with opened(source) as descriptor:
        found = _examine(descriptor, source)
        file = OutputFile(output)
        try:
            _write_copy(descriptor, found, file)
        except BaseException:
            file.discard()
            raise
    return _summarise(output, found)


def salvage_in_place(path: Path) -> Salvaged:
    """Finish an unfinished file; one called ``x.mcap.active`` is ``x.mcap`` afterwards.

    Only the end of the file changes: what was cut off goes, the summary comes. A file with its end is left alone.

    Raises
    ------
    RecordingUnfinishedError
        There is nothing in it that could be kept; it is left as it is.
    RecordingExistsError
        There is a finished file of that name already.
    RecordingError, DiskFullError
        It cannot be read or written, is damaged before its end, or is still being written.
    """
    target = path.with_name(path.name.removesuffix(".active"))
    if target != path and os.path.lexists(target):
        raise RecordingExistsError(f"{target} exists already and is not overwritten.", hint="Salvage to an --output.")
    with opened(path) as descriptor:
        found = _examine(descriptor, path)
        if not found.was_complete:
            _verify_end_only(path, found)
            _finish(descriptor, path, found)
    if target != path:
        with explained(target):
            rename_new(path, target)
    return _summarise(target, found)


@dataclass(slots=True)
class _Found:
    """A file of which every part has been looked at."""

    container: Container
    chunks: list[Chunk]
    notes: list[Note]
    was_complete: bool
    lost: list[str]

    @property
    def parts(self) -> list[Chunk | Note]:
        """All that is kept, in the order of the file."""
        return sorted([*self.chunks, *self.notes], key=attrgetter("start"))


def _examine(descriptor: int, path: Path) -> _Found:
    try:
        container = scan_container(descriptor)
    except DamagedError as error:
        raise RecordingUnfinishedError(f"{path} {error}: nothing in it can be kept.") from error
    defined = {channel.id for channel in _define(container)[1]}
    chunks = [chunk for chunk in container.chunks if _is_sound(descriptor, chunk, container, defined)]
    notes = [note for note in container.notes if _is_kept(descriptor, note, container)]
    lost = [*container.damage, *_describe_rest(container)]
    if not chunks and not (container.finished and not lost):
        reason = f": {lost[0]}" if lost else ""
        raise RecordingUnfinishedError(f"{path} holds no whole record that could be kept{reason}.")
    return _Found(container, chunks, notes, container.finished and not lost, lost)


def _is_sound(descriptor: int, chunk: Chunk, container: Container, defined: set[int]) -> bool:
    try:
        data = read_chunk(descriptor, chunk)
        if not has_sound_index(descriptor, chunk, data):
            chunk.index.clear()
            chunk.counts = count_messages(data)
        _verify_defined(chunk, defined)
    except DamagedError as error:
        container.note_damage(chunk.offset, f"{describe_chunk(chunk, container.channels)}: {error}")
        return False
    return True


def _verify_defined(chunk: Chunk, defined: set[int]) -> None:
    unknown = sorted(chunk.counts.keys() - defined)
    if unknown:
        raise DamagedError(f"nothing in the file says what its channels are: {', '.join(map(str, unknown))}")


def _is_kept(descriptor: int, note: Note, container: Container) -> bool:
    if note.opcode not in {METADATA, ATTACHMENT}:
        return False
    try:
        read_note(descriptor, note)
    except DamagedError as error:
        kind = "metadata" if note.opcode == METADATA else "an attachment"
        container.note_damage(note.start, f"{note.end - note.start} bytes of {kind} at byte {note.start}: {error}")
        return False
    return True


def _describe_rest(container: Container) -> list[str]:
    n_bytes = container.size - container.end
    # a summary that was cut off can be made again; what follows a run's end is the record that begins it
    in_summary = container.data_ended or ("bench.end" in container.metadata and n_bytes < DATA_END_SIZE)
    if container.finished or in_summary or not n_bytes:
        return []
    return [f"{n_bytes} bytes from byte {container.end} on: {container.problem}"]


def _write_copy(descriptor: int, found: _Found, file: OutputFile) -> None:
    schemas, channels = _define(found.container)
    opening = MAGIC + encode_records([_read_header(descriptor), *schemas, *channels])
    pieces = _encode_pieces(descriptor, found, Ending(schemas, channels), len(opening))
    with explained(file.path):
        file.stream.write(opening)
        for piece in pieces:
            file.stream.write(piece)
        file.sync()
        file.publish()


def _verify_end_only(path: Path, found: _Found) -> None:
    """Check that everything is sound in front of what is cut away."""
    if any(chunk.is_loose for chunk in found.chunks):
        raise RecordingError(
            f"{path} holds messages outside of chunks: it cannot be finished in place.",
            hint="Salvage it to an --output.",
        )
    damage = [chunk.end for chunk in found.chunks[:-1] if not chunk.index]
    if found.container.first_damage is not None:
        damage.append(found.container.first_damage)
    if damage and min(damage) < found.chunks[-1].end:
        raise RecordingError(
            f"{path} is damaged at byte {min(damage)}, before its end: it cannot be finished in place.",
            hint="Salvage it to an --output.",
        )


def _finish(descriptor: int, path: Path, found: _Found) -> None:
    keep = found.chunks[-1].end
    end = b"".join(_encode_pieces(descriptor, found, Ending(*_define(found.container)), keep, keep))
    with explained(path), path.open("r+b") as stream:
        if os.fstat(stream.fileno()).st_size != found.container.size:
            raise RecordingError(f"{path} has grown while it was read: something still writes it.")
        stream.truncate(keep)
        stream.seek(keep)
        stream.write(end)
        stream.flush()
        os.fsync(stream.fileno())


def _encode_pieces(descriptor: int, found: _Found, ending: Ending, position: int, keep: int = 0) -> Iterator[bytes]:
    """Yield what is to be written from `position` on; what lies before `keep` stays where it is."""
    for part in found.parts:
        if part.start < keep:
            _note_part(descriptor, part, part.start, ending)
            # the cut may have taken a part of the last chunk's index
            piece = _encode_index(descriptor, part) if isinstance(part, Chunk) and part.end == keep else b""
        else:
            piece, put = _move(descriptor, part, position)
            _note_part(descriptor, put, position, ending)
            piece += _encode_index(descriptor, part) if isinstance(part, Chunk) else b""
        position += len(piece)
        yield piece
    note = _encode_salvage(found)
    ending.note_metadata(SALVAGE, position, len(note))
    yield note + ending.encode(position + len(note))


def _move(descriptor: int, part: Chunk | Note, position: int) -> tuple[bytes, Chunk | Note]:
    """Return a part as it is to stand at `position`, and its description there; loose messages become a chunk."""
    if not isinstance(part, Chunk) or not part.is_loose:
        return os.pread(descriptor, part.end - part.start, part.start), part
    data = bytes(read_chunk(descriptor, part))
    packed = lz4.frame.compress(data)
    record = encode_records(
        [records.Chunk("lz4", packed, part.end_ns, part.start_ns, zlib.crc32(data), uncompressed_size=len(data))]
    )
    at = position + len(record) - len(packed)
    return record, replace(part, offset=position + HEAD.size, data_offset=at, data_size=len(packed), compression="lz4")


def _note_part(descriptor: int, part: Chunk | Note, start: int, ending: Ending) -> None:
    if isinstance(part, Chunk):
        ending.note_chunk(part, start)
        return
    record, size = read_note(descriptor, part), part.end - part.start
    if isinstance(record, records.Metadata):
        ending.note_metadata(record.name, start, size)
    else:
        ending.note_attachment(record, start, size)


def _encode_index(descriptor: int, chunk: Chunk) -> bytes:
    """Return the index records of a chunk, in the order of its counts."""
    if chunk.index:
        size = sum(HEAD.size + INDEX_HEAD.size + 16 * n for n in chunk.counts.values())
        return os.pread(descriptor, size, chunk.end)
    made = index_messages(read_chunk(descriptor, chunk))
    return b"".join(made[channel] for channel in chunk.counts)


def _encode_salvage(found: _Found) -> bytes:
    before = found.container.metadata.get(SALVAGE, {}).get("lost", "")
    lost = [*filter(None, [before]), *found.lost]
    if not _is_closed(found.container) and LAST_SECOND not in before:
        lost.append(LAST_SECOND)
    return encode_records([records.Metadata(SALVAGE, {"lost": "; ".join(lost)})])


def _is_closed(container: Container) -> bool:
    return "bench.end" in container.metadata or "bench.run" not in container.metadata


def _read_header(descriptor: int) -> records.Header:
    head = os.pread(descriptor, HEAD.size + LARGEST_HEADER, len(MAGIC))
    opcode, length = HEAD.unpack_from(head)
    try:
        if opcode == _HEADER and length <= LARGEST_HEADER:
            header: records.Header = records.Header.read(ReadDataStream(BytesIO(head[HEAD.size : HEAD.size + length])))
            return header
    except (struct.error, ValueError, McapError):
        pass  # damaged: it says nothing that the recording needs
    return records.Header(profile="ros2", library="bench")


def _define(container: Container) -> tuple[list[records.Schema], list[records.Channel]]:
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


def _summarise(path: Path, found: _Found) -> Salvaged:
    topics: dict[str, int] = {}
    for chunk in found.chunks:
        for key, n in chunk.counts.items():
            topic = found.container.channels[key].topic
            topics[topic] = topics.get(topic, 0) + n
    return Salvaged(path, topics, tuple(found.lost), _is_closed(found.container), found.was_complete)
