"""Chunks that follow each other, unpacked into one piece of memory, and where in it the messages are.

A recorder that syncs twice a second leaves chunks of a quarter megabyte, in each of which numpy's calls cost more
than its copying. Together they cost less, while they still fit into a core's share of the cache.
"""

from __future__ import annotations

import threading
from collections.abc import Collection, Iterable, Iterator, Sequence
from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from bench.recording.container.chunks import Data, Offsets, are_messages, read_chunk, read_index, read_offsets
from bench.recording.container.contents import Chunk, DamagedError
from bench.recording.files.run_files import RunFiles
from bench.recording.reading.gathering import MESSAGE_HEAD

__all__ = ["Batch", "find_messages", "group_chunks", "unpack_batch"]

BATCH_BYTES = 4 << 20
"""Of several chunks together; a chunk that is larger is one by itself. Half or twice as much is slower
(1 MiB of second-level cache for each of two cores, measured 2026-11)."""


@dataclass(frozen=True, slots=True)
class Batch:
    """Chunks that follow each other, unpacked."""

    chunks: tuple[Chunk, ...]
    """Those that are undamaged."""
    data: Data
    """Holds until the thread that unpacked it unpacks the next."""
    ends: tuple[int, ...]
    """Where in the data each chunk ends."""
    damaged: tuple[tuple[Chunk, DamagedError], ...] = ()
    """Those that do not unpack."""

    def split(self) -> Iterator[Batch]:
        """Yield the undamaged chunks one by one."""
        for chunk, (start, end) in zip(self.chunks, pairwise((0, *self.ends)), strict=True):
            yield Batch((chunk,), self.data[start:end], (end - start,))


class _Memory(threading.local):
    """What each thread unpacks into, again and again: pages that are new each time take longer to fill."""

    def __init__(self) -> None:
        self.data = np.empty(BATCH_BYTES, np.uint8)


_memory = _Memory()


def group_chunks(chunks: Iterable[Chunk]) -> Iterator[list[Chunk]]:
    """Put together chunks of up to `BATCH_BYTES`."""
    group: list[Chunk] = []
    size = 0
    for chunk in chunks:
        if group and size + chunk.unpacked_size > BATCH_BYTES:
            yield group
            group, size = [], 0
        group.append(chunk)
        size += chunk.unpacked_size
    if group:
        yield group


def unpack_batch(files: RunFiles, chunks: Sequence[Chunk]) -> Batch:
    """Unpack the chunks of one group."""
    if len(chunks) == 1:
        return _unpack_one(files, chunks[0])
    sound: list[Chunk] = []
    damaged: list[tuple[Chunk, DamagedError]] = []
    ends = [0]
    for chunk in chunks:
        try:
            data = read_chunk(files, chunk)
        except DamagedError as error:
            damaged.append((chunk, error))
            continue
        sound.append(chunk)
        ends.append(ends[-1] + len(data))
        _memory.data[ends[-2] : ends[-1]] = np.frombuffer(data, np.uint8)
    return Batch(tuple(sound), _memory.data.data[: ends[-1]], tuple(ends[1:]), tuple(damaged))


def _unpack_one(files: RunFiles, chunk: Chunk) -> Batch:
    try:
        data = read_chunk(files, chunk)
    except DamagedError as error:
        return Batch((), b"", (), ((chunk, error),))
    return Batch((chunk,), data, (len(data),))


def find_messages(files: RunFiles, batch: Batch, wanted: Collection[int]) -> dict[int, Offsets]:
    """Return where the messages of each wanted channel begin in the batch's data.

    Raises
    ------
    DamagedError
        Of a single chunk: it cannot be read. Of several: one of them is to be read by itself.
    """
    if len(batch.chunks) == 1:
        return read_offsets(files, batch.chunks[0], batch.data, wanted)
    found: dict[int, list[Offsets]] = {}
    for chunk, (start, end) in zip(batch.chunks, pairwise((0, *batch.ends)), strict=True):
        for channel, offsets in read_index(files, chunk, wanted).items():
            _verify_inside(offsets, chunk.index[channel][1], end - start)
            found.setdefault(channel, []).append(offsets + start)
        if not chunk.index:
            raise DamagedError("it has no index")
    joined = {channel: np.concatenate(places) for channel, places in found.items()}
    if not all(are_messages(batch.data, offsets, channel) for channel, offsets in joined.items()):
        raise DamagedError("its index is wrong")
    return joined


def _verify_inside(offsets: Offsets, n_expected: int, size: int) -> None:
    """Check that a chunk's index is all there, and names no place in the chunk behind it."""
    if len(offsets) != n_expected:
        raise DamagedError("its index is cut off")
    if n_expected and not 0 <= offsets[0] <= offsets[-1] <= size - MESSAGE_HEAD.itemsize:
        raise DamagedError("its index names places outside of it")
