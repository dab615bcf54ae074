"""Making a sound file of an unfinished or damaged one: every whole record is kept, byte for byte, and nothing else.

A copy takes what is sound and leaves the rest out. In place a file is only finished: what was cut off at its end is
taken away and the missing summary is written, so that the work does not grow with what it holds. Before either, every
chunk is unpacked and held against its checksum.

A run that was split by size is named by its first part. In place each part that needs it gets its end; a copy is one
file with all of them.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections import Counter
from collections.abc import Generator, Iterator, Sequence
from dataclasses import dataclass, replace
from io import BytesIO
from pathlib import Path

import lz4.frame
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError

from bench.errors import RecordingError, RecordingExistsError, RecordingUnfinishedError
from bench.recording.container.chunks import index_messages, read_chunk
from bench.recording.container.contents import HEAD, INDEX_HEAD, MAGIC, Chunk, DamagedError, Note
from bench.recording.container.ending import Ending, encode_records
from bench.recording.container.notes import read_note
from bench.recording.container.scanning import scan_container
from bench.recording.files.output import OutputFile, explained, final_path, rename_new
from bench.recording.files.part_names import CONTINUES, FIRST_NUMBER, PART, read_number
from bench.recording.files.run_files import RunFiles, opened
from bench.recording.reading.joining import FoundParts, find_parts
from bench.recording.reading.status import LAST_SECOND, SALVAGE, count_by_topic
from bench.recording.salvage.examining import Examined, define_topics, examine

__all__ = ["Salvaged", "salvage_copy", "salvage_in_place"]

_HEADER = 1
LARGEST_HEADER = 4096
"""Bytes of the file's header record: two short names."""


@dataclass(frozen=True, slots=True)
class Salvaged:
    """What was kept of a run, and what was not."""

    path: Path
    """Where it is now, or its first part."""
    topics: dict[str, int]
    """Messages kept, by topic."""
    lost: tuple[str, ...]
    """What stood in a file and could not be kept, and what files are missing; one sentence each."""
    is_closed: bool
    """Its recorder had come to the end of the run. Otherwise about the last second never reached the file."""
    was_complete: bool
    """Every file had its end, and no damage."""


@dataclass(frozen=True, slots=True)
class _Run:
    """All files of a run, examined."""

    files: list[Examined]
    lost: list[str]
    """What cannot be kept, in words."""

    def summarise(self, path: Path) -> Salvaged:
        topics: Counter[str] = Counter()
        for one in self.files:
            topics.update(count_by_topic(replace(one.container, chunks=one.chunks)))
        was_complete = not self.lost and all(one.was_complete for one in self.files)
        return Salvaged(path, topics, tuple(self.lost), all(one.is_closed for one in self.files), was_complete)


def salvage_copy(source: Path, output: Path) -> Salvaged:
    """Write all that is sound in `source` into a new file; if it is a run's first part, of all parts into one.

    Raises
    ------
    RecordingUnfinishedError
        There is nothing in it that could be kept; no file is written.
    RecordingExistsError
        `output` exists.
    RecordingError, DiskFullError
        `source` cannot be read, or `output` not be written.
    """
    run = _examine_run(source)
    file = OutputFile(output)
    try:
        with explained(output):
            for piece in _encode_copy(run):
                file.stream.write(piece)
            file.sync()
            file.publish()
    except BaseException:
        file.discard()
        raise
    return run.summarise(output)


def salvage_in_place(path: Path) -> Salvaged:
    """Finish an unfinished file; one called ``x.mcap.active`` is ``x.mcap`` afterwards. So with all parts of a run.

    Only the end of a file changes: what was cut off goes, the summary comes. A file with its end is left alone.

    Raises
    ------
    RecordingUnfinishedError
        There is nothing in it that could be kept; it is left as it is.
    RecordingExistsError
        There is a finished file of that name already.
    RecordingError, DiskFullError
        It cannot be read or written, is damaged before its end, or is still being written.
    """
    run = _examine_run(path)
    for one in run.files:
        _verify_name_free(one.path)
        if not one.was_complete:
            _verify_end_only(one)
    for one in run.files:
        if not one.was_complete:
            _finish(one)
        target = final_path(one.path)
        if target != one.path:
            with explained(target):
                rename_new(one.path, target)
    return run.summarise(final_path(path))


def _examine_run(path: Path) -> _Run:
    """Examine all files of the run that begins in `path`, or `path` alone if it is a later part."""
    found = _find(path)
    files: list[Examined] = []
    lost, errors = found.describe_missing(), []
    for part in found.parts:
        try:
            with opened(part.path) as file:
                files.append(examine(file, part.path, part.container, is_followed=found.is_followed(part)))
        except RecordingUnfinishedError as error:
            errors.append(error)
    if not files:
        raise errors[0]
    several = len(found.parts) > 1
    lost += [f"{one.path.name}: {text}" if several else text for one in files for text in one.lost]
    return _Run(files, [*lost, *map(str, errors)])


def _find(path: Path) -> FoundParts:
    with opened(path) as file:
        try:
            container = scan_container(file)
        except DamagedError as error:
            raise RecordingUnfinishedError(f"{path} {error}: nothing in it can be kept.") from error
    if "bench.run" in container.metadata and read_number(container.metadata) == FIRST_NUMBER:
        return find_parts(path, container)
    return FoundParts.alone(path, container)


def _verify_name_free(path: Path) -> None:
    target = final_path(path)
    if target != path and os.path.lexists(target):
        raise RecordingExistsError(f"{target} exists already and is not overwritten.", hint="Salvage to an --output.")


def _encode_copy(run: _Run) -> Iterator[bytes]:
    """Yield a whole file that holds what is sound in all files of a run."""
    is_whole = read_number(run.files[0].container.metadata) == FIRST_NUMBER
    schemas: dict[int, records.Schema] = {}
    channels: dict[int, records.Channel] = {}
    for one in run.files:
        found = define_topics(one.container)
        schemas = {schema.id: schema for schema in found[0]} | schemas
        channels = {channel.id: channel for channel in found[1]} | channels
    ending = Ending(schemas.values(), channels.values())
    with opened(run.files[0].path) as file:
        opening = MAGIC + encode_records([_read_header(file), *schemas.values(), *channels.values()])
    yield opening
    position, repeated = len(opening), set[bytes]()
    for one in run.files:
        with opened(one.path) as file:
            kept = [part for part in one.parts if not is_whole or _is_news(file, part, repeated)]
            position = yield from _encode_parts(file, kept, ending, position)
    yield _encode_end(run, ending, position)


def _is_news(file: RunFiles, part: Chunk | Note, repeated: set[bytes]) -> bool:
    """Tell whether a part of a file belongs into a copy of all files: each begins with what was said before it."""
    if isinstance(part, Chunk):
        return True
    note = read_note(file, part)
    encoded = encode_records([note])
    if encoded in repeated or (isinstance(note, records.Metadata) and note.name in (PART, CONTINUES)):
        return False
    repeated.add(encoded)
    return True


def _verify_end_only(found: Examined) -> None:
    """Check that everything is sound in front of what is cut away."""
    if any(chunk.is_loose for chunk in found.chunks):
        raise RecordingError(
            f"{found.path} holds messages outside of chunks: it cannot be finished in place.",
            hint="Salvage it to an --output.",
        )
    damage = [chunk.end for chunk in found.chunks[:-1] if not chunk.index]
    if found.container.first_damage is not None:
        damage.append(found.container.first_damage)
    if damage and min(damage) < found.data_end:
        raise RecordingError(
            f"{found.path} is damaged at byte {min(damage)}, before its end: it cannot be finished in place.",
            hint="Salvage it to an --output.",
        )


def _finish(found: Examined) -> None:
    path, keep = found.path, found.data_end
    with opened(path) as file:
        end = b"".join(_encode_new_end(file, found, keep))
    with explained(path), path.open("r+b") as stream:
        if os.fstat(stream.fileno()).st_size != found.container.size:
            raise RecordingError(f"{path} has grown while it was read: something still writes it.")
        stream.truncate(keep)
        stream.seek(keep)
        stream.write(end)
        stream.flush()
        os.fsync(stream.fileno())


def _encode_new_end(file: RunFiles, found: Examined, keep: int) -> Iterator[bytes]:
    """Yield what is to be written from `keep` on; what lies before stays where it is."""
    ending = Ending(*define_topics(found.container))
    for part in found.parts:
        if part.start < keep:
            _note_part(file, part, part.start, ending)
    position = keep
    if found.chunks:  # the cut may have taken a part of the last chunk's index
        index = _encode_index(file, found.chunks[-1])
        position += len(index)
        yield index
    behind = [part for part in found.parts if part.start >= keep]
    position = yield from _encode_parts(file, behind, ending, position)
    yield _encode_end(_Run([found], found.lost), ending, position)


def _encode_parts(
    file: RunFiles, parts: Sequence[Chunk | Note], ending: Ending, position: int
) -> Generator[bytes, None, int]:
    """Yield parts of a file as they are to stand from `position` on; return where they end."""
    for part in parts:
        piece, put = _move(file, part, position)
        _note_part(file, put, position, ending)
        piece += _encode_index(file, part) if isinstance(part, Chunk) else b""
        position += len(piece)
        yield piece
    return position


def _encode_end(run: _Run, ending: Ending, position: int) -> bytes:
    note = _encode_salvage(run)
    ending.note_metadata(SALVAGE, position, len(note))
    return note + ending.encode(position + len(note))


def _move(file: RunFiles, part: Chunk | Note, position: int) -> tuple[bytes, Chunk | Note]:
    """Return a part as it is to stand at `position`, and its description there; loose messages become a chunk."""
    if not isinstance(part, Chunk) or not part.is_loose:
        return file.pread(part.end - part.start, part.start), part
    data = bytes(read_chunk(file, part))
    packed = lz4.frame.compress(data)
    record = encode_records(
        [records.Chunk("lz4", packed, part.end_ns, part.start_ns, zlib.crc32(data), uncompressed_size=len(data))]
    )
    at = position + len(record) - len(packed)
    return record, replace(part, offset=position + HEAD.size, data_offset=at, data_size=len(packed), compression="lz4")


def _note_part(file: RunFiles, part: Chunk | Note, start: int, ending: Ending) -> None:
    if isinstance(part, Chunk):
        ending.note_chunk(part, start)
        return
    record, size = read_note(file, part), part.end - part.start
    if isinstance(record, records.Metadata):
        ending.note_metadata(record.name, start, size)
    else:
        ending.note_attachment(record, start, size)


def _encode_index(file: RunFiles, chunk: Chunk) -> bytes:
    """Return the index records of a chunk, in the order of its counts."""
    if chunk.index:
        size = sum(HEAD.size + INDEX_HEAD.size + 16 * n for n in chunk.counts.values())
        return file.pread(size, chunk.end)
    made = index_messages(read_chunk(file, chunk))
    return b"".join(made[channel] for channel in chunk.counts)


def _encode_salvage(run: _Run) -> bytes:
    before = [one.container.metadata.get(SALVAGE, {}).get("lost", "") for one in run.files]
    lost = [*filter(None, before), *run.lost]
    if not all(one.is_closed for one in run.files) and not any(LAST_SECOND in text for text in before):
        lost.append(LAST_SECOND)
    return encode_records([records.Metadata(SALVAGE, {"lost": "; ".join(lost)})])


def _read_header(file: RunFiles) -> records.Header:
    head = file.pread(HEAD.size + LARGEST_HEADER, len(MAGIC))
    opcode, length = HEAD.unpack_from(head)
    try:
        if opcode == _HEADER and length <= LARGEST_HEADER:
            header: records.Header = records.Header.read(ReadDataStream(BytesIO(head[HEAD.size : HEAD.size + length])))
            return header
    except (struct.error, ValueError, McapError):
        pass  # damaged: it says nothing that the recording needs
    return records.Header(profile="ros2", library="bench")
