"""One chunk of an MCAP file: unpacked, held against its checksum, and where in it the messages are.

References
----------
MCAP specification, mcap.dev/spec.
"""

from __future__ import annotations

import struct
from collections.abc import Collection, Iterator

import lz4.frame
import numpy as np
import numpy.typing as npt
import zstandard
from isal.isal_zlib import crc32

from bench.recording.container.contents import (
    HEAD,
    INDEX_HEAD,
    LARGEST_CHUNK,
    MESSAGE,
    MESSAGE_INDEX,
    Chunk,
    DamagedError,
)
from bench.recording.files.run_files import RunFiles

__all__ = [
    "Data",
    "Offsets",
    "are_messages",
    "count_messages",
    "find_times",
    "has_sound_index",
    "index_messages",
    "read_chunk",
    "read_index",
    "read_offsets",
    "walk_records",
]

_MESSAGE_HEAD = 22  # channel, sequence, two times

Data = bytes | memoryview
"""Of an unpacked chunk."""
Offsets = npt.NDArray[np.int64]
"""Where messages begin in it, ascending."""


def read_chunk(files: RunFiles, chunk: Chunk) -> Data:
    """Return the unpacked records of a chunk.

    Raises
    ------
    DamagedError
        It does not unpack, or not to what its checksum says.
    """
    packed = files.pread(chunk.data_size, chunk.data_offset, chunk.part)
    try:
        data = _unpack(packed, chunk)
    except (OSError, RuntimeError, ValueError, EOFError, MemoryError, zstandard.ZstdError) as error:
        raise DamagedError(f"it does not unpack: {error}") from error
    if len(data) != chunk.unpacked_size:
        raise DamagedError(f"it unpacks to {len(data)} bytes instead of {chunk.unpacked_size}")
    if chunk.checksum and crc32(data) != chunk.checksum:
        raise DamagedError("its checksum is wrong")
    return data


def _unpack(packed: bytes, chunk: Chunk) -> Data:
    if chunk.compression == "lz4":
        # Arrow's does not tell how much it unpacked, so it is for what has a checksum
        return (_unpack_checked_lz4 if chunk.checksum else _unpack_lz4)(packed, chunk.unpacked_size)
    if chunk.compression == "zstd":
        # the stream reader stops at the size asked for, whatever the frame claims to hold
        unpacker = zstandard.ZstdDecompressor(max_window_size=1 << 27).stream_reader(packed)
        return unpacker.read(chunk.unpacked_size + 1)
    if chunk.compression:
        raise DamagedError(f"the compression '{chunk.compression[:20]}' is not known")
    return packed


def _unpack_checked_lz4(packed: bytes, size: int) -> memoryview:
    """Unpack into memory that Arrow keeps and gives out again: three times as fast as into pages that are new."""
    from pyarrow import Codec

    return memoryview(Codec("lz4").decompress(packed, size))


def _unpack_lz4(packed: bytes, size: int) -> bytes:
    decompressor = lz4.frame.LZ4FrameDecompressor()
    data = bytes(decompressor.decompress(packed, max_length=size + 1))
    if len(data) == size and not decompressor.eof:
        raise ValueError("its end mark is missing")  # without which other readers refuse it
    return data


def has_sound_index(files: RunFiles, chunk: Chunk, data: Data) -> bool:
    """Tell whether the message index behind a chunk names all of its messages, and their places and times."""
    n_bytes, expected = 0, chunk.end
    for channel, (position, n) in chunk.index.items():
        expected += HEAD.size + INDEX_HEAD.size
        entries = np.frombuffer(files.pread(16 * n, position, chunk.part), "<i8")
        times, offsets = entries[0::2], entries[1::2]
        if position != expected or len(entries) != 2 * n or not are_messages(data, np.sort(offsets), channel):
            return False
        expected += 16 * n
        if (_read_i64(data, offsets + HEAD.size + 6) != times).any():
            return False
        n_bytes += HEAD.size * n + int(_read_i64(data, offsets + 1).sum())
    # what is left over are definitions, or messages that the index does not name
    return n_bytes == len(data) or count_messages(data) == chunk.counts


def _read_i64(data: Data, offsets: Offsets) -> npt.NDArray[np.int64]:
    places: npt.NDArray[np.int64] = np.ndarray((max(len(data) - 7, 0),), "<i8", data, strides=(1,))
    return places[offsets]


def read_offsets(files: RunFiles, chunk: Chunk, data: Data, wanted: Collection[int]) -> dict[int, Offsets]:
    """Return where the messages of each wanted channel begin in the unpacked `data`; the head of each is whole."""
    found = read_index(files, chunk, wanted)
    is_sound = all(
        len(offsets) == chunk.index[key][1] and are_messages(data, offsets, key) for key, offsets in found.items()
    )
    if not chunk.index or not is_sound:
        found = {key: offsets for key, offsets in _walk_messages(data).items() if key in wanted}
    return found


def read_index(files: RunFiles, chunk: Chunk, wanted: Collection[int]) -> dict[int, Offsets]:
    """Return what the index says; of an index that is not all there, nothing."""
    places = {key: place for key, place in chunk.index.items() if key in wanted}
    start = min((position for position, _ in places.values()), default=0)
    end = max((position + 16 * n for position, n in places.values()), default=0)
    raw = files.pread(min(end - start, LARGEST_CHUNK), start, chunk.part)
    if len(raw) != end - start:
        return {key: np.empty(0, np.int64) for key in places}
    return {key: np.sort(np.frombuffer(raw, "<i8", 2 * n, at - start)[1::2]) for key, (at, n) in places.items()}


def are_messages(data: Data, offsets: Offsets, channel: int) -> bool:
    """Check that the index, which has no checksum of its own, points at messages of its channel, at each once."""
    n_places = len(data) - HEAD.size - _MESSAGE_HEAD + 1
    if len(offsets) == 0:
        return True
    if offsets[0] < 0 or offsets[-1] >= n_places or (offsets[1:] == offsets[:-1]).any():
        return False
    opcodes = np.frombuffer(data, np.uint8)
    channels: npt.NDArray[np.uint16] = np.ndarray((n_places,), "<u2", data, HEAD.size, strides=(1,))
    return bool((opcodes[offsets] == MESSAGE).all() and (channels[offsets] == channel).all())


def walk_records(data: Data) -> Iterator[tuple[int, int, int]]:
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


def count_messages(data: Data) -> dict[int, int]:
    """Return how many messages of each channel are in an unpacked chunk, by reading all of it."""
    return {channel: len(offsets) for channel, offsets in _walk_messages(data).items()}


def find_times(data: Data) -> tuple[int, int]:
    """Return the first and the last log time in an unpacked chunk, (0, 0) if it holds no message."""
    places = list(_walk_messages(data).values())
    times = _read_i64(data, np.concatenate([np.empty(0, np.int64), *places]) + HEAD.size + 6)
    return (int(times.min()), int(times.max())) if len(times) else (0, 0)


def index_messages(data: Data) -> dict[int, bytes]:
    """Return a message index record for each channel in an unpacked chunk, made by reading all of it."""
    made = {}
    for channel, offsets in _walk_messages(data).items():
        entries = np.stack([_read_i64(data, offsets + HEAD.size + 6), offsets], axis=1)
        body = INDEX_HEAD.pack(channel, entries.nbytes) + entries.tobytes()
        made[channel] = HEAD.pack(MESSAGE_INDEX, len(body)) + body
    return made


def _walk_messages(data: Data) -> dict[int, Offsets]:
    found: dict[int, list[int]] = {}
    for opcode, start, end in walk_records(data):
        if opcode == MESSAGE:
            if end - start < _MESSAGE_HEAD:
                raise DamagedError("a message is shorter than its own head")
            (channel,) = struct.unpack_from("<H", data, start)
            found.setdefault(channel, []).append(start - HEAD.size)
    return {channel: np.array(offsets, np.int64) for channel, offsets in found.items()}
