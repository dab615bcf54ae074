"""What stands where in an MCAP file, finished or not, and how a chunk of it is read.

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
from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass, field
from datetime import UTC, datetime

import lz4.frame
import numpy as np
import numpy.typing as npt
import zstandard
from mcap import records

__all__ = [
    "ATTACHMENT",
    "CHANNEL",
    "HEAD",
    "INDEX_HEAD",
    "LARGEST_CHUNK",
    "LARGEST_NOTE",
    "MAGIC",
    "MESSAGE",
    "MESSAGE_INDEX",
    "METADATA",
    "SCHEMA",
    "Channel",
    "Chunk",
    "Container",
    "DamagedError",
    "Note",
    "count_messages",
    "describe_chunk",
    "has_sound_index",
    "index_messages",
    "read_chunk",
    "read_offsets",
    "walk_records",
]

MAGIC = b"\x89MCAP0\r\n"
LARGEST_CHUNK = 256 << 20
"""Bytes a chunk may unpack to. Ours hold about 1 MiB; one giant frame could make one larger."""
LARGEST_NOTE = 64 << 20
"""Bytes of a schema, channel or metadata record."""
MOST_DAMAGE = 1000
"""Damaged parts that are named one by one."""
SCHEMA, CHANNEL, MESSAGE, MESSAGE_INDEX, ATTACHMENT, METADATA = 3, 4, 5, 7, 9, 12
HEAD = struct.Struct("<BQ")
"""Of every record: opcode and length of what follows."""
INDEX_HEAD = struct.Struct("<HI")
"""Of a message index: channel and bytes of entries."""
_MESSAGE_HEAD = 22  # channel, sequence, two times

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


@dataclass(frozen=True, slots=True)
class Note:
    """A definition, metadata or an attachment outside of chunks: where its record begins and ends."""

    opcode: int
    start: int
    end: int


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

    @property
    def start(self) -> int:
        """Where its record begins."""
        return self.offset - HEAD.size

    @property
    def end(self) -> int:
        """Where its record ends."""
        return self.data_offset + self.data_size


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
    first_damage: int | None = None
    """Where the first part begins that was skipped."""
    schemas: dict[int, records.Schema] = field(default_factory=dict)
    registered: dict[int, records.Channel] = field(default_factory=dict)
    """The channels as the file defines them."""
    notes: list[Note] = field(default_factory=list)
    """What stands outside of chunks, in the order of the file."""
    data_ended: bool = False
    """What follows is the summary."""
    repeated: list[tuple[Note, bytes]] = field(default_factory=list)
    """Definitions in the summary, which count when its checksum is right."""
    current: Chunk | None = None
    """The chunk that the next index records belong to."""

    def note_damage(self, offset: int, text: str) -> None:
        """Note a part that is skipped; a file that is all damage does not fill the memory with sentences."""
        self.first_damage = offset if self.first_damage is None else min(offset, self.first_damage)
        if text in self.damage:
            return
        if len(self.damage) < MOST_DAMAGE:
            self.damage.append(text)
        elif len(self.damage) == MOST_DAMAGE:
            self.damage.append("and more")


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


def describe_chunk(chunk: Chunk, channels: Mapping[int, Channel]) -> str:
    """Return where a chunk is, from when, and how many messages of which topics its index promises."""
    counts = [f"{n} of {channels[key].topic}" for key, n in sorted(chunk.counts.items()) if key in channels]
    try:
        begin, end = (datetime.fromtimestamp(ns * 1e-9, tz=UTC) for ns in (chunk.start_ns, chunk.end_ns))
        times = f"{begin:%Y-%m-%d %H:%M:%S.%f} to {end:%H:%M:%S.%f} UTC"
    except (ValueError, OverflowError, OSError):
        times = "of unknown time"
    promised = f"; {', '.join(counts)}" if counts else ""
    return f"the chunk at byte {chunk.offset} ({chunk.data_size} bytes, {times}{promised})"


def has_sound_index(descriptor: int, chunk: Chunk, data: bytes) -> bool:
    """Tell whether the message index behind a chunk names all of its messages, and their places and times."""
    n_bytes, expected = 0, chunk.end
    for channel, (position, n) in chunk.index.items():
        expected += HEAD.size + INDEX_HEAD.size
        entries = np.frombuffer(os.pread(descriptor, 16 * n, position), "<u8")
        times, offsets = entries[0::2], entries[1::2]
        if position != expected or len(entries) != 2 * n or not _are_messages(data, offsets, channel):
            return False
        expected += 16 * n
        if (_read_u64(data, offsets + np.uint64(HEAD.size + 6)) != times).any():
            return False
        n_bytes += HEAD.size * n + int(_read_u64(data, offsets + np.uint64(1)).sum())
    # what is left over are definitions, or messages that the index does not name
    return n_bytes == len(data) or count_messages(data) == chunk.counts


def _read_u64(data: bytes, offsets: npt.NDArray[np.uint64]) -> npt.NDArray[np.uint64]:
    places: npt.NDArray[np.uint64] = np.ndarray((max(len(data) - 7, 0),), "<u8", data, strides=(1,))
    return places[offsets]


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
    if int(entries.max()) + HEAD.size + _MESSAGE_HEAD > len(data):
        return False
    raw = np.frombuffer(data, np.uint8)
    low, high = raw[entries + np.uint64(9)], raw[entries + np.uint64(10)]
    return bool(((raw[entries] == MESSAGE) & (low == channel & 0xFF) & (high == channel >> 8)).all())


def _unpack_lz4(packed: bytes, size: int) -> bytes:
    decompressor = lz4.frame.LZ4FrameDecompressor()
    data = bytes(decompressor.decompress(packed, max_length=size + 1))
    if len(data) == size and not decompressor.eof:
        raise ValueError("its end mark is missing")  # without which other readers refuse it
    return data


def _unpack_zstd(packed: bytes, size: int) -> bytes:
    # the stream reader stops at the size asked for, whatever the frame claims to hold
    return zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(packed).read(size + 1)


def _unpack_nothing(packed: bytes, _size: int) -> bytes:
    return packed


_UNPACK: dict[str, Callable[[bytes, int], bytes]] = {"lz4": _unpack_lz4, "zstd": _unpack_zstd, "": _unpack_nothing}


def walk_records(data: bytes) -> Iterator[tuple[int, int, int]]:
    """Yield opcode, start and end of each record's body in an unpacked chunk."""
    offset = 0
    while offset < len(data):
        if offset + HEAD.size > len(data):
            raise DamagedError("its last record has no head")
        opcode, length = HEAD.unpack_from(data, offset)
        start = offset + HEAD.size
        offset = start + length
        if offset > len(data):
            raise DamagedError("a record is longer than what is left of it")
        yield opcode, start, offset


def count_messages(data: bytes) -> dict[int, int]:
    """Return how many messages of each channel are in an unpacked chunk, by reading all of it."""
    return {channel: len(offsets) for channel, offsets in _walk_messages(data).items()}


def index_messages(data: bytes) -> dict[int, bytes]:
    """Return a message index record for each channel in an unpacked chunk, made by reading all of it."""
    made = {}
    for channel, offsets in _walk_messages(data).items():
        entries = np.stack([_read_u64(data, (offsets + HEAD.size + 6).astype("<u8")), offsets.astype("<u8")], axis=1)
        body = INDEX_HEAD.pack(channel, entries.nbytes) + entries.tobytes()
        made[channel] = HEAD.pack(MESSAGE_INDEX, len(body)) + body
    return made


def _walk_messages(data: bytes) -> dict[int, Offsets]:
    found: dict[int, list[int]] = {}
    for opcode, start, end in walk_records(data):
        if opcode == MESSAGE:
            if end - start < _MESSAGE_HEAD:
                raise DamagedError("a message is shorter than its own head")
            (channel,) = struct.unpack_from("<H", data, start)
            found.setdefault(channel, []).append(start - HEAD.size)
    return {channel: np.array(offsets, np.int64) for channel, offsets in found.items()}
