"""Chunks unpacked ahead of whoever takes them apart, in a thread of their own, and small ones put together.

Unpacking and the checksum run without the interpreter's lock, so a second core does them meanwhile. A recorder that
syncs twice a second leaves chunks of a quarter megabyte, in each of which numpy's calls cost more than its copying.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Collection, Iterable, Iterator
from concurrent.futures import Future, ThreadPoolExecutor
from dataclasses import dataclass

import numpy as np

from bench.recording.chunks import Data, Offsets, read_chunk, read_offsets
from bench.recording.container import Chunk, DamagedError
from bench.recording.files import RunFiles

__all__ = ["Batch", "read_ahead"]

BATCH_BYTES = 1 << 20
"""Chunks are put together up to about this, which a core's own cache still holds."""
AHEAD = 2
"""Batches unpacked while one is taken apart, for some take longer than others."""


@dataclass(frozen=True, slots=True)
class Batch:
    """Chunks that follow each other, unpacked into one piece of memory."""

    chunks: tuple[Chunk, ...]
    """Those that are undamaged."""
    data: Data
    ends: tuple[int, ...]
    """Where in the data each chunk ends."""
    offsets: dict[int, Offsets]
    """Where the messages of each wanted channel begin."""
    damaged: tuple[tuple[Chunk, DamagedError], ...]

    def split(self) -> Iterator[Batch]:
        """Yield the chunks one by one, where they lie."""
        bounds = {key: np.searchsorted(offsets, [0, *self.ends]) for key, offsets in self.offsets.items()}
        for i, (chunk, end) in enumerate(zip(self.chunks, self.ends, strict=True)):
            own = {key: offsets[bounds[key][i] : bounds[key][i + 1]] for key, offsets in self.offsets.items()}
            yield Batch((chunk,), self.data, (end,), own, ())


def read_ahead(files: RunFiles, chunks: Iterable[Chunk], wanted: Collection[int]) -> Iterator[Batch]:
    """Yield all of the chunks, with the messages of the wanted channels."""
    with ThreadPoolExecutor(1, "unpacking") as thread:
        ahead: deque[Future[Batch]] = deque()
        for group in _group_chunks(chunks):
            ahead.append(thread.submit(_read_batch, files, group, wanted))
            if len(ahead) > AHEAD:
                yield ahead.popleft().result()
        while ahead:
            yield ahead.popleft().result()


def _group_chunks(chunks: Iterable[Chunk]) -> Iterator[list[Chunk]]:
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


def _read_batch(files: RunFiles, chunks: list[Chunk], wanted: Collection[int]) -> Batch:
    sound: list[Chunk] = []
    parts: list[Data] = []
    offsets: dict[int, list[Offsets]] = {}
    damaged, ends = [], [0]
    for chunk in chunks:
        try:
            data = read_chunk(files, chunk)
            found = read_offsets(files, chunk, data, wanted)
        except DamagedError as error:
            damaged.append((chunk, error))
            continue
        for channel, places in found.items():
            offsets.setdefault(channel, []).append(places + ends[-1])
        sound.append(chunk)
        parts.append(data)
        ends.append(ends[-1] + len(data))
    joined = parts[0] if len(parts) == 1 else b"".join(parts)
    places_in_all = {channel: np.concatenate(places) for channel, places in offsets.items()}
    return Batch(tuple(sound), joined, tuple(ends[1:]), places_in_all, tuple(damaged))
