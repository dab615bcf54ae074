"""What stands where in an MCAP file: one pass over the record headers, for finished and unfinished files alike.

The file's own summary is not needed for that, so a file that lost its end is read in the same way as one that has
it. Nothing is believed unseen: every length is checked against the file, every chunk against its checksum, and what
a chunk may unpack to is limited.

References
----------
MCAP specification, mcap.dev/spec.
"""

from __future__ import annotations

import os
import struct
import zlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from io import BytesIO

import lz4.frame
import numpy as np
import numpy.typing as npt
import zstandard
from mcap import records
from mcap.data_stream import ReadDataStream
from mcap.exceptions import McapError

__all__ = [
    "MAGIC",
    "Channel",
    "Chunk",
    "Container",
    "DamagedError",
    "read_chunk",
    "read_offsets",
    "scan_container",
    "scan_further",
]

MAGIC = b"\x89MCAP0\r\n"
LARGEST_CHUNK = 256 << 20
"""Bytes a chunk may unpack to. Ours hold about 1 MiB; one giant frame could make one larger."""
LARGEST_NOTE = 64 << 20
"""Bytes of a schema, channel or metadata record."""
_SCHEMA, _CHANNEL, _MESSAGE, _CHUNK, _MESSAGE_INDEX = 3, 4, 5, 6, 7
_METADATA, _FOOTER = 12, 2
_KNOWN = frozenset(range(1, 16))
_PRIVATE = 0x80
_MESSAGE_HEAD = 22  # channel, sequence, two times
_HEAD = struct.Struct("<BQ")
_CHUNK_HEAD = struct.Struct("<QQQII")
_INDEX_HEAD = struct.Struct("<HI")

Offsets = npt.NDArray[np.int64]


class DamagedError(Exception):
    """A part of the file is not what it should be. Callers skip the part and say so."""


@dataclass(frozen=True, slots=True)
class Channel:
    """Where the messages of one topic are."""

    id: int
    topic: str
    encoding: str
    schema_name: str
    """Empty, like encoding and text, where only the topic is known."""
    schema_encoding: str
    schema_text: str


@dataclass(slots=True)
class Chunk:
    """One chunk, not yet read."""

    offset: int
    """Of its record in the file."""
    data_offset: int
    data_size: int
    unpacked_size: int
    checksum: int
    compression: str
    start_ns: int
    end_ns: int
    index: dict[int, tuple[int, int]] = field(default_factory=dict)
    """File offset and number of the index entries, by channel."""
    counts: dict[int, int] = field(default_factory=dict)
    """Messages by channel."""


@dataclass(slots=True)
class Container:
    """All of the file that could be understood."""

    size: int
    end: int = 0
    """Bytes understood, from the start."""
    finished: bool = False
    """The file has its footer."""
    problem: str = ""
    """Why the pass ended before the footer."""
    chunks: list[Chunk] = field(default_factory=list)
    channels: dict[int, Channel] = field(default_factory=dict)
    metadata: dict[str, dict[str, str]] = field(default_factory=dict)
    damage: list[str] = field(default_factory=list)
    """One sentence for each part that was skipped."""
    schemas: dict[int, records.Schema] = field(default_factory=dict)
    current: Chunk | None = None
    """The chunk that the next index records belong to."""


def scan_container(descriptor: int) -> Container:
    """Pass over an open file.

    Raises
    ------
    DamagedError
        The file does not begin as an MCAP file does.
    """
    if os.pread(descriptor, len(MAGIC), 0) != MAGIC:
        raise DamagedError("is not an MCAP file")
    found = Container(size=0, end=len(MAGIC))
    scan_further(descriptor, found)
    return found


def scan_further(descriptor: int, found: Container) -> None:
    """Go on where an earlier pass over the same file ended, for it has grown since: note what was added."""
    if found.finished:
        return
    found.size, found.problem = os.fstat(descriptor).st_size, ""
    known, offset = len(found.chunks), found.end
    while not found.finished:
        try:
            length = _scan_record(descriptor, offset, found)
        except DamagedError as error:
            found.problem = str(error)
            break
        offset += _HEAD.size + length
    if found.finished and os.pread(descriptor, len(MAGIC), offset) != MAGIC:
        found.finished, found.problem = False, f"the closing bytes are missing at byte {offset}"
    found.end = offset + (len(MAGIC) if found.finished else 0)
    if not found.finished and len(found.chunks) > known:
        # the cut may have taken a part of the last chunk's index
        found.chunks[-1].index.clear()
        found.chunks[-1].counts.clear()
        found.current = None
    found.chunks[known:] = [chunk for chunk in found.chunks[known:] if _is_understood(descriptor, chunk, found)]


def read_chunk(descriptor: int, chunk: Chunk) -> bytes:
    """Return the unpacked records of a chunk.

    Raises
    ------
    DamagedError
        It does not unpack, or not to what its checksum says.
    """
    packed = os.pread(descriptor, chunk.data_size, chunk.data_offset)
    try:
        data = _UNPACK[chunk.compression](packed, chunk.unpacked_size)
    except KeyError as error:
        raise DamagedError(f"the compression '{chunk.compression[:20]}' is not known") from error
    except (RuntimeError, ValueError, EOFError, MemoryError, zstandard.ZstdError) as error:
        raise DamagedError(f"it does not unpack: {error}") from error
    if len(data) != chunk.unpacked_size:
        raise DamagedError(f"it unpacks to {len(data)} bytes instead of {chunk.unpacked_size}")
    if chunk.checksum and zlib.crc32(data) != chunk.checksum:
        raise DamagedError("its checksum is wrong")
    return data


def read_offsets(descriptor: int, chunk: Chunk, data: bytes) -> dict[int, Offsets]:
    """Return where each channel's messages begin in the unpacked `data`, in the order of the file."""
    if not chunk.index:
        return _walk_messages(data)
    offsets = {}
    for channel, (position, n) in chunk.index.items():
        entries = np.frombuffer(os.pread(descriptor, 16 * n, position), "<u8")[1::2]
        if len(entries) != n or not _are_messages(data, entries, channel):
            return _walk_messages(data)
        offsets[channel] = np.sort(entries.astype(np.int64))
    return offsets


def _are_messages(data: bytes, entries: npt.NDArray[np.uint64], channel: int) -> bool:
    """Check that the index, which has no checksum of its own, points at messages of its channel."""
    if len(entries) == 0:
        return True
    if int(entries.max()) + _HEAD.size + _MESSAGE_HEAD > len(data):
        return False
    raw = np.frombuffer(data, np.uint8)
    low, high = raw[entries + np.uint64(9)], raw[entries + np.uint64(10)]
    return bool(((raw[entries] == _MESSAGE) & (low == channel & 0xFF) & (high == channel >> 8)).all())


def _unpack_lz4(packed: bytes, size: int) -> bytes:
    return bytes(lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1))


def _unpack_zstd(packed: bytes, size: int) -> bytes:
    # the stream reader stops at the size asked for, whatever the frame claims to hold
    return zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(packed).read(size + 1)


def _unpack_nothing(packed: bytes, _size: int) -> bytes:
    return packed


_UNPACK: dict[str, Callable[[bytes, int], bytes]] = {"lz4": _unpack_lz4, "zstd": _unpack_zstd, "": _unpack_nothing}


def _scan_record(descriptor: int, offset: int, found: Container) -> int:
    """Note one record and return its length."""
    head = os.pread(descriptor, 96, offset)
    if len(head) < _HEAD.size:
        raise DamagedError(f"the file ends at byte {found.size}, before its footer")
    opcode, length = _HEAD.unpack_from(head)
    if opcode not in _KNOWN and opcode < _PRIVATE:
        raise DamagedError(f"no record begins at byte {offset}")
    if offset + _HEAD.size + length > found.size:
        raise DamagedError(f"the record at byte {offset} is cut off by the end of the file, or its length is wrong")
    body = offset + _HEAD.size
    if opcode == _CHUNK:
        _note_chunk(head[_HEAD.size :], body, length, found)
    elif opcode == _MESSAGE_INDEX:
        _note_index(head[_HEAD.size :], body, length, found)
    elif opcode == _MESSAGE:
        raise DamagedError(f"a message stands outside a chunk at byte {offset}")
    elif opcode in {_SCHEMA, _CHANNEL, _METADATA}:
        _note_definition(opcode, _read_note(descriptor, body, length), found)
    elif opcode == _FOOTER:
        found.finished = True
    return int(length)


def _note_chunk(head: bytes, body: int, length: int, found: Container) -> None:
    try:
        start, end, unpacked, checksum, name_size = _CHUNK_HEAD.unpack_from(head)
        name = head[_CHUNK_HEAD.size : _CHUNK_HEAD.size + name_size].decode()
        (data_size,) = struct.unpack_from("<Q", head, _CHUNK_HEAD.size + name_size)
    except (struct.error, UnicodeDecodeError):
        found.damage.append(f"the chunk at byte {body} has an unreadable head")
        found.current = None
        return
    head_size = _CHUNK_HEAD.size + name_size + 8
    if head_size + data_size != length or max(unpacked, data_size) > LARGEST_CHUNK:
        found.damage.append(f"the chunk at byte {body} has impossible lengths")
        found.current = None
        return
    found.current = Chunk(body, body + head_size, data_size, unpacked, checksum, name, start, end)
    found.chunks.append(found.current)


def _note_index(head: bytes, body: int, length: int, found: Container) -> None:
    if length < _INDEX_HEAD.size or found.current is None:
        return
    channel, size = _INDEX_HEAD.unpack_from(head)
    if size != length - _INDEX_HEAD.size or size % 16 or size // 16 * 31 > found.current.unpacked_size:
        # a broken index is worth nothing, but the chunk can be walked without it
        found.current.index.clear()
        found.current.counts.clear()
        found.current = None
        return
    found.current.index[channel] = (body + _INDEX_HEAD.size, size // 16)
    found.current.counts[channel] = size // 16


def _read_note(descriptor: int, body: int, length: int) -> bytes:
    if length > LARGEST_NOTE:
        raise DamagedError(f"the record at byte {body} has an impossible length of {length}")
    return os.pread(descriptor, length, body)


def _note_definition(opcode: int, body: bytes, found: Container) -> None:
    stream = ReadDataStream(BytesIO(body))
    try:
        if opcode == _SCHEMA:
            schema = records.Schema.read(stream)
            found.schemas[schema.id] = schema
        elif opcode == _CHANNEL:
            _note_channel(records.Channel.read(stream), found)
        else:
            note = records.Metadata.read(stream)
            found.metadata.setdefault(note.name, {}).update(note.metadata)
    except (struct.error, ValueError, McapError) as error:
        found.damage.append(f"a record of kind {opcode} cannot be read: {error}")


def _note_channel(channel: records.Channel, found: Container) -> None:
    schema = found.schemas.get(channel.schema_id)
    name, encoding, text = (schema.name, schema.encoding, schema.data) if schema else ("", "", b"")
    found.channels[channel.id] = Channel(
        channel.id, channel.topic, channel.message_encoding, name, encoding, text.decode("utf-8", "replace")
    )


def _is_understood(descriptor: int, chunk: Chunk, found: Container) -> bool:
    """Look into a chunk only where its index does not already say what is in it."""
    if chunk.index and all(channel in found.channels for channel in chunk.index):
        return True
    try:
        data = read_chunk(descriptor, chunk)
        for opcode, start, end in _walk(data):
            if opcode in {_SCHEMA, _CHANNEL}:
                _note_definition(opcode, data[start:end], found)
        _adopt_promised_channels(found)
        if not chunk.index:
            chunk.counts = {channel: len(offsets) for channel, offsets in _walk_messages(data).items()}
    except DamagedError as error:
        found.damage.append(f"the chunk at byte {chunk.offset} is damaged: {error}")
        return False
    return True


def _adopt_promised_channels(found: Container) -> None:
    """Take from the metadata which topic a channel is, where the chunk that says so with its definition is lost."""
    for key, topic in found.metadata.get("bench.channels", {}).items():
        if key.isascii() and key.isdigit():
            found.channels.setdefault(int(key), Channel(int(key), topic, "cdr", "", "", ""))


def _walk(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and end of each record's body in an unpacked chunk."""
    offset = 0
    while offset < len(data):
        if offset + _HEAD.size > len(data):
            raise DamagedError("its last record has no head")
        opcode, length = _HEAD.unpack_from(data, offset)
        start = offset + _HEAD.size
        offset = start + length
        if offset > len(data):
            raise DamagedError("a record is longer than what is left of it")
        yield opcode, start, offset


def _walk_messages(data: bytes) -> dict[int, Offsets]:
    found: dict[int, list[int]] = {}
    for opcode, start, end in _walk(data):
        if opcode == _MESSAGE:
            if end - start < _MESSAGE_HEAD:
                raise DamagedError("a message is shorter than its own head")
            (channel,) = struct.unpack_from("<H", data, start)
            found.setdefault(channel, []).append(start - _HEAD.size)
    return {channel: np.array(offsets, np.int64) for channel, offsets in found.items()}
