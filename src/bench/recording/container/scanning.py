"""One pass over the record headers of an MCAP file: what is where, finished or not.

Damage costs what is damaged: behind a head that makes no sense the pass goes on with the next sound chunk. Messages
outside of chunks, as other programs may write them, are taken as chunks that are neither packed nor have a checksum.
"""

from __future__ import annotations

import re
import struct
import zlib
from io import BytesIO

from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError

from bench.recording.container.chunks import count_messages, find_times, read_chunk, walk_records
from bench.recording.container.contents import (
    ATTACHMENT,
    CHANNEL,
    HEAD,
    INDEX_HEAD,
    LARGEST_CHUNK,
    LARGEST_NOTE,
    MAGIC,
    MESSAGE,
    MESSAGE_INDEX,
    METADATA,
    SCHEMA,
    Channel,
    Chunk,
    Container,
    DamagedError,
    Note,
    describe_chunk,
)
from bench.recording.files.run_files import RunFiles

__all__ = ["scan_container", "scan_further"]

MOST_NOTES = 100_000
"""Records outside of chunks; a run file has some twenty."""
LOOSE_BYTES = 1 << 20
"""Messages outside of chunks are taken as chunks of about this size."""
SEARCH_BYTES = 1 << 20
"""Bytes looked through at a time for the next chunk behind damage."""
_CHUNK, _FOOTER, _DATA_END = 6, 2, 15
_KNOWN = frozenset(range(1, 16))
_PRIVATE = 0x80
_CHUNK_HEAD = struct.Struct("<QQQII")
_MESSAGE_HEAD = struct.Struct("<HIQQ")
"""Channel, sequence, log time, publish time."""
_FOOTER_BODY = struct.Struct("<QQI")
_LARGEST_HEAD = 96  # bytes: more than the head of any chunk
_COMPRESSION = re.compile(rb"\x03\0\0\0lz4|\x04\0\0\0zstd")


def scan_container(file: RunFiles) -> Container:
    """Pass over an open file.

    Raises
    ------
    DamagedError
        The file does not begin as an MCAP file does.
    """
    found = Container(size=file.size(), end=len(MAGIC))
    if file.pread(len(MAGIC), 0) != MAGIC:
        if _find_chunk(file, len(MAGIC), min(found.size, SEARCH_BYTES)) is None:
            raise DamagedError("is not an MCAP file")
        found.note_damage(0, "the opening bytes are wrong")
    scan_further(file, found)
    return found


def scan_further(file: RunFiles, found: Container) -> None:
    """Go on where an earlier pass over the same file ended, for it has grown since: note what was added."""
    if found.finished:
        return
    found.size, found.problem = file.size(), ""
    n_known, offset = len(found.chunks), found.end
    while not found.finished:
        try:
            length = _scan_record(file, offset, found)
        except DamagedError as error:
            next_chunk = _find_chunk(file, offset + 1, found.size)
            if next_chunk is None:
                found.problem = str(error)
                break
            found.note_damage(offset, f"{next_chunk - offset} bytes from byte {offset} on: {error}")
            _distrust_index(found)
            offset = next_chunk
        else:
            offset += HEAD.size + length
    if found.finished and file.pread(len(MAGIC), offset) != MAGIC:
        found.finished, found.problem = False, f"the closing bytes are missing at byte {offset}"
    found.end = offset + (len(MAGIC) if found.finished else 0)
    if not found.finished and len(found.chunks) > n_known:
        # the cut may have taken a part of the last chunk's index
        found.chunks[-1].index.clear()
        found.chunks[-1].counts.clear()
        found.current = None
    found.chunks[n_known:] = [chunk for chunk in found.chunks[n_known:] if _is_understood(file, chunk, found)]


def _scan_record(file: RunFiles, offset: int, found: Container) -> int:
    """Note one record and return its length."""
    head = file.pread(_LARGEST_HEAD, offset)
    if len(head) < HEAD.size:
        raise DamagedError(f"the file ends at byte {found.size}, before its footer")
    opcode, length = HEAD.unpack_from(head)
    if opcode not in _KNOWN and opcode < _PRIVATE:
        raise DamagedError(f"no record begins at byte {offset}")
    if offset + HEAD.size + length > found.size:
        raise DamagedError(f"the record at byte {offset} is cut off by the end of the file, or its length is wrong")
    body = offset + HEAD.size
    if opcode == _CHUNK:
        _note_chunk(head[HEAD.size :], body, length, found)
    elif opcode == MESSAGE_INDEX:
        _note_index(file, head[HEAD.size :], body, length, found)
    elif opcode == MESSAGE:
        _note_loose_message(head[HEAD.size :], offset, HEAD.size + length, found)
    elif opcode in {SCHEMA, CHANNEL, METADATA, ATTACHMENT}:
        _note_record(file, Note(opcode, offset, offset + HEAD.size + length), found)
    elif opcode == _FOOTER:
        _end_summary(file, offset, head[HEAD.size :], found)
    elif opcode >= _PRIVATE:
        _distrust_index(found)  # it may be a part of the index whose kind is damaged
    found.data_ended |= opcode == _DATA_END
    return int(length)


def _find_chunk(file: RunFiles, start: int, size: int) -> int | None:
    """Return where the next undamaged chunk begins: what stands behind a damaged length is not lost with it."""
    name_at = HEAD.size + _CHUNK_HEAD.size - 4
    for base in range(start + name_at, size, SEARCH_BYTES):
        block = file.pread(SEARCH_BYTES + 8, base)
        for match in _COMPRESSION.finditer(block):
            offset = base + match.start() - name_at
            if match.start() < SEARCH_BYTES and _begins_chunk(file, offset, size):
                return offset
    return None


def _begins_chunk(file: RunFiles, offset: int, size: int) -> bool:
    head = file.pread(_LARGEST_HEAD, offset)
    opcode, length = HEAD.unpack_from(head)
    if opcode != _CHUNK or offset + HEAD.size + length > size:
        return False
    trial = Container(size)
    _note_chunk(head[HEAD.size :], offset + HEAD.size, length, trial)
    try:
        return trial.current is not None and len(read_chunk(file, trial.current)) > 0
    except DamagedError:
        return False


def _note_record(file: RunFiles, note: Note, found: Container) -> None:
    if len(found.notes) >= MOST_NOTES:
        raise DamagedError(f"more than {MOST_NOTES} records stand outside of chunks")
    found.notes.append(note)
    if note.opcode == ATTACHMENT:
        return
    start = note.start + HEAD.size
    body = _read_note(file, start, note.end - start)
    if found.data_ended:
        found.repeated.append((note, body))
    else:
        _note_definition(note.opcode, start, body, found)


def _end_summary(file: RunFiles, offset: int, footer: bytes, found: Container) -> None:
    """Believe what the summary repeats if its checksum is right; otherwise it is read from the chunks."""
    found.finished = True
    if len(footer) < _FOOTER_BODY.size:
        return
    start, _, checksum = _FOOTER_BODY.unpack_from(footer)
    size = offset + HEAD.size + _FOOTER_BODY.size - 4 - start
    if checksum and not (0 < size <= LARGEST_CHUNK and zlib.crc32(file.pread(size, start)) == checksum):
        return
    for note, body in found.repeated:
        _note_definition(note.opcode, note.start, body, found)


def _note_chunk(head: bytes, body: int, length: int, found: Container) -> None:
    try:
        start, end, unpacked, checksum, name_size = _CHUNK_HEAD.unpack_from(head)
        name = head[_CHUNK_HEAD.size : _CHUNK_HEAD.size + name_size].decode()
        (data_size,) = struct.unpack_from("<Q", head, _CHUNK_HEAD.size + name_size)
    except (struct.error, UnicodeDecodeError):
        found.note_damage(body, f"the chunk at byte {body} has an unreadable head")
        found.current = None
        return
    head_size = _CHUNK_HEAD.size + name_size + 8
    if head_size + data_size != length or max(unpacked, data_size) > LARGEST_CHUNK:
        found.note_damage(body, f"the chunk at byte {body} has impossible lengths")
        found.current = None
        return
    found.current = Chunk(body, body + head_size, data_size, unpacked, checksum, name, start, end)
    found.chunks.append(found.current)


def _note_loose_message(head: bytes, offset: int, size: int, found: Container) -> None:
    if not HEAD.size + _MESSAGE_HEAD.size <= size <= LARGEST_CHUNK:
        raise DamagedError(f"the message at byte {offset} has an impossible length")
    _, _, log_time_ns, _ = _MESSAGE_HEAD.unpack_from(head)
    found.current = None  # an index that follows is not of the chunk before
    last = found.chunks[-1] if found.chunks else None
    if last is None or not last.is_loose or last.end != offset or last.data_size + size > LOOSE_BYTES:
        last = Chunk(offset + HEAD.size, offset, 0, 0, 0, "", log_time_ns, log_time_ns, is_loose=True)
        found.chunks.append(last)
    last.data_size = last.unpacked_size = last.data_size + size
    last.start_ns, last.end_ns = min(last.start_ns, log_time_ns), max(last.end_ns, log_time_ns)


def _note_index(file: RunFiles, head: bytes, body: int, length: int, found: Container) -> None:
    chunk = found.current
    if length < INDEX_HEAD.size or chunk is None:
        return
    channel, size = INDEX_HEAD.unpack_from(head)
    if size != length - INDEX_HEAD.size or size % 16 or size // 16 * 31 > chunk.unpacked_size:
        _distrust_index(found)
        return
    chunk.index[channel] = (body + INDEX_HEAD.size, size // 16)
    chunk.counts[channel] = size // 16
    if size:
        first, last = head[INDEX_HEAD.size :][:8], file.pread(8, body + length - 16)
        times = [int.from_bytes(entry, "little") for entry in (first, last)]
        chunk.is_dated &= all(chunk.start_ns <= time_ns <= chunk.end_ns for time_ns in times)


def _distrust_index(found: Container) -> None:
    """Forget the index of the chunk before: it is read from the chunk itself instead."""
    if found.current is not None:
        found.current.index.clear()
        found.current.counts.clear()
        found.current = None


def _read_note(file: RunFiles, body: int, length: int) -> bytes:
    if length > LARGEST_NOTE:
        raise DamagedError(f"the record at byte {body} has an impossible length of {length}")
    return file.pread(length, body)


def _note_definition(opcode: int, offset: int, body: bytes, found: Container) -> None:
    stream = ReadDataStream(BytesIO(body))
    try:
        if opcode == SCHEMA:
            schema = records.Schema.read(stream)
            found.schemas[schema.id] = schema
        elif opcode == CHANNEL:
            _note_channel(records.Channel.read(stream), found)
        else:
            note = records.Metadata.read(stream)
            found.metadata.setdefault(note.name, {}).update(note.metadata)
    except (struct.error, ValueError, McapError) as error:
        found.note_damage(offset, f"a record of kind {opcode} cannot be read: {error}")


def _note_channel(channel: records.Channel, found: Container) -> None:
    found.registered[channel.id] = channel
    schema = found.schemas.get(channel.schema_id)
    name, encoding, text = (schema.name, schema.encoding, schema.data) if schema else ("", "", b"")
    found.channels[channel.id] = Channel(
        channel.id, channel.topic, channel.message_encoding, name, encoding, text.decode("utf-8", "replace")
    )


def _is_understood(file: RunFiles, chunk: Chunk, found: Container) -> bool:
    """Look into a chunk only where its index does not already say what is in it."""
    if chunk.index and chunk.is_dated and all(channel in found.channels for channel in chunk.index):
        return True
    try:
        data = read_chunk(file, chunk)
        for opcode, start, end in walk_records(data):
            if opcode in {SCHEMA, CHANNEL}:
                _note_definition(opcode, chunk.offset, bytes(data[start:end]), found)
        _adopt_promised_channels(found)
        if not chunk.is_dated:
            chunk.start_ns, chunk.end_ns = find_times(data)
        counts = count_messages(data)
        if counts != chunk.counts:
            chunk.index.clear()
            chunk.counts = counts
    except DamagedError as error:
        found.note_damage(chunk.offset, f"{describe_chunk(chunk, found)}: {error}")
        return False
    return True


def _adopt_promised_channels(found: Container) -> None:
    """Take from the metadata which topic a channel is, where the chunk that says so with its definition is lost."""
    for key, topic in found.metadata.get("bench.channels", {}).items():
        if key.isascii() and key.isdigit():
            found.channels.setdefault(int(key), Channel(int(key), topic, "cdr", "", "", ""))
