"""Messages to numpy columns, a whole chunk at a time wherever every message of a topic has the same layout.

The layout comes from the message definition in the file. A fixed message is then one numpy record.
"""

from __future__ import annotations

from typing import Any, Protocol

import numpy as np

from bench.recording.container.chunks import Data, Offsets
from bench.recording.container.contents import DamagedError
from bench.recording.messages.cdr import HEADER, CdrError, Layout, decode, encode
from bench.recording.messages.pointcloud import CLOUD_SCHEMA
from bench.recording.messages.schemas import PRIMITIVES, Schema
from bench.recording.reading.clouds import CloudCollector
from bench.recording.reading.columns import HEAD_COLUMNS, Array, allocate_columns
from bench.recording.reading.gathering import MESSAGE_HEAD, OWN_HEAD, gather, gather_heads, payload_of

__all__ = ["Collector", "make_collector"]

_CDR_HEADER = np.frombuffer(HEADER, "<u4")[0]
LARGEST_LAYOUT = 1 << 16
"""Bytes of a message that is read as one numpy record."""


class Collector(Protocol):
    """Gathers one topic, chunk by chunk."""

    def take(self, data: Data, offsets: Offsets) -> None:
        """Add the messages that begin at `offsets`; `DamagedError` if they cannot be read."""
        ...

    def mark(self) -> tuple[int, ...]:
        """Return where it stands."""
        ...

    def return_to(self, mark: tuple[int, ...]) -> None:
        """Forget what was added since."""
        ...

    def columns(self) -> dict[str, Array]:
        """Return all that was added."""
        ...


def make_collector(schema: Schema, capacity: int) -> Collector:
    """Return the collector that suits a message definition; no more than `capacity` messages are expected."""
    if schema.name == CLOUD_SCHEMA:
        return CloudCollector(schema, capacity)
    fields = schema.fields
    if all(field.type in PRIMITIVES and field.length != -1 for field in fields):
        return _FixedCollector(schema, capacity)
    return _TextCollector(schema)


class _FixedCollector:
    """Messages that are all of one size."""

    def __init__(self, schema: Schema, capacity: int) -> None:
        layout = Layout.of(schema)
        if layout.size > LARGEST_LAYOUT:
            raise CdrError(f"{schema.name} has {layout.size} bytes; {LARGEST_LAYOUT} is the limit")
        self._size, self._capacity = layout.size, capacity
        self._record = _join_head(_without_vectors(layout.dtype))
        fields = {leaf.path: _kind_of(layout.dtype[leaf.path], leaf.code) for leaf in layout.leaves}
        # a field called as one of the head's, the robot's own sequence, takes its place: it has more bits
        self._arrays = allocate_columns({**HEAD_COLUMNS, **fields}, capacity)
        self._targets = {name: _by_row(array) for name, array in self._arrays.items()}
        self._names = frozenset(fields)
        self._filled = 0

    def take(self, data: Data, offsets: Offsets) -> None:
        records = gather(data, offsets, self._record)
        heads, rows = records["head"], records["payload"]
        if (heads["length"] != OWN_HEAD + self._size).any():
            raise DamagedError("a message is not as long as its definition says")
        if (records["encoding"] != _CDR_HEADER).any():
            raise DamagedError("a message is not little-endian CDR")
        end = self._filled + len(rows)
        if end > self._capacity:
            raise DamagedError("it holds more messages than its index says")
        for name, target in self._targets.items():
            target[self._filled : end] = rows[name] if name in self._names else heads[name]
        self._filled = end

    def mark(self) -> tuple[int, ...]:
        return (self._filled,)

    def return_to(self, mark: tuple[int, ...]) -> None:
        (self._filled,) = mark

    def columns(self) -> dict[str, Array]:
        return {name: array[: self._filled] for name, array in self._arrays.items()}


class _TextCollector:
    """Messages that hold texts, decoded one by one: there are few of them."""

    def __init__(self, schema: Schema) -> None:
        self._schema = schema
        example = encode(schema, {})
        self._numbers = {leaf.path: np.dtype("<" + leaf.code) for leaf in Layout.of(schema, example).leaves}
        self._values: dict[str, list[Any]] = {path: [] for path in decode(schema, example)}
        self._heads: list[Array] = []
        self._filled = 0

    def take(self, data: Data, offsets: Offsets) -> None:
        heads = gather_heads(data, offsets)
        lengths = heads["length"].tolist()
        try:
            decoded = [
                decode(self._schema, payload_of(data, offset, length))
                for offset, length in zip(offsets.tolist(), lengths, strict=True)
            ]
        except CdrError as error:
            raise DamagedError(str(error)) from error
        for path, values in self._values.items():
            values.extend(message.get(path) for message in decoded)
        self._heads.append(heads)
        self._filled += len(heads)

    def mark(self) -> tuple[int, ...]:
        return len(self._heads), self._filled

    def return_to(self, mark: tuple[int, ...]) -> None:
        n_heads, self._filled = mark
        del self._heads[n_heads:]
        for values in self._values.values():
            del values[self._filled :]

    def columns(self) -> dict[str, Array]:
        heads = np.concatenate([np.empty(0, MESSAGE_HEAD), *self._heads])
        columns = {name: heads[name].astype(kind) for name, kind in HEAD_COLUMNS.items()}
        for path, values in self._values.items():
            columns[path.replace(".", "_")] = np.array(values, self._numbers.get(path, np.dtype(object)))
        return columns


def _kind_of(kind: np.dtype[Any], code: str) -> np.dtype[Any]:
    return np.dtype((np.dtype(bool), kind.shape)) if code == "?" else kind


def _without_vectors(dtype: np.dtype[Any]) -> np.dtype[Any]:
    """Return a record whose vectors are bytes: numpy then moves each at once, and not number by number."""
    places: Any = dtype.fields
    kinds = {name: kind for name, (kind, _) in places.items()}
    layout: Any = {
        "names": list(kinds),
        "formats": [f"V{kind.itemsize}" if _is_moved_whole(kind) else kind for kind in kinds.values()],
        "offsets": [place[1] for place in places.values()],
        "itemsize": dtype.itemsize,
    }
    moved: np.dtype[Any] = np.dtype(layout)
    return moved


def _is_moved_whole(kind: np.dtype[Any]) -> bool:
    return bool(kind.shape) and kind.base.kind in "if"  # a byte may stand for a truth value: any but zero is true


def _by_row(array: Array) -> Array:
    """Return a view of an array of vectors with each as so many bytes, where `_without_vectors` does the same."""
    kind = np.dtype((array.dtype, array.shape[1:]))
    return array.view(f"V{kind.itemsize}").reshape(len(array)) if _is_moved_whole(kind) else array


def _join_head(payload: np.dtype[Any]) -> np.dtype[Any]:
    """Return a whole message record as numpy has it, so that one copy brings all of it."""
    at = MESSAGE_HEAD.itemsize
    return np.dtype(
        {
            "names": ["head", "encoding", "payload"],
            "formats": [MESSAGE_HEAD, _CDR_HEADER.dtype, payload],
            "offsets": [0, at, at],
            "itemsize": at + payload.itemsize,
        }
    )
