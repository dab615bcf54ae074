"""Messages to numpy columns, a whole chunk at a time wherever every message of a topic has the same layout.

The layout comes from the message definition in the file. A fixed message is then one numpy record: a view of the
chunk that begins a record at every byte, indexed with the messages' offsets, copies them out in one call.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from typing import Any, Protocol

import numpy as np
import numpy.typing as npt

from bench.recording.cdr import HEADER, CdrError, Layout, decode, encode
from bench.recording.container import DamagedError, Offsets
from bench.recording.pointcloud import CLOUD_SCHEMA, CLOUD_TAIL_SIZE, POINT, read_points, verify_cloud
from bench.recording.schemas import PRIMITIVES, Schema

__all__ = ["HEAD_COLUMNS", "Collector", "Columns", "make_collector", "read_message"]

Array = npt.NDArray[Any]

MESSAGE_HEAD = np.dtype(
    [
        ("opcode", "u1"),
        ("length", "<u8"),
        ("channel", "<u2"),
        ("sequence", "<u4"),
        ("log_time_ns", "<i8"),
        ("publish_time_ns", "<i8"),
    ]
)
"""An MCAP message record up to its payload; the times are unsigned there, and int64 here until the year 2262."""
HEAD_COLUMNS = {"log_time_ns": np.int64, "publish_time_ns": np.int64, "sequence": np.int64}
"""What every topic has besides its fields."""
_CDR_HEADER = np.frombuffer(HEADER, "<u4")[0]
_MESSAGE = 5
_OWN_HEAD = MESSAGE_HEAD.itemsize - 9  # counted in the record's length: all but opcode and length
LARGEST_LAYOUT = 1 << 16
"""Bytes of a message that is read as one numpy record."""


class Columns(Mapping[str, Array]):
    """One topic as numpy arrays of the same length, by ``columns["name"]`` or ``columns.name``.

    Names are those of the record's fields in `bench.model`; besides them ``log_time_ns`` (arrival),
    ``publish_time_ns`` (capture) and ``sequence``. Vectors have shape (n, 3), (n, 4) or (n, 6). Texts are arrays of
    `str` (dtype object). ``offsets``, where a topic has it, is one longer than the number of frames.
    """

    def __init__(self, arrays: Mapping[str, Array]) -> None:
        self._arrays = dict(arrays)

    def __getitem__(self, name: str) -> Array:
        return self._arrays[name]

    def __getattr__(self, name: str) -> Array:
        try:
            return self.__dict__["_arrays"][name]  # type: ignore[no-any-return]
        except KeyError:
            raise AttributeError(f"no column '{name}'; there are: {', '.join(sorted(self))}") from None

    def __iter__(self) -> Iterator[str]:
        return iter(self._arrays)

    def __len__(self) -> int:
        return len(self._arrays)

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self._arrays]

    def __repr__(self) -> str:
        shapes = ", ".join(f"{name} {array.dtype}{list(array.shape)}" for name, array in self._arrays.items())
        return f"Columns({shapes})"


class Collector(Protocol):
    """Gathers one topic, chunk by chunk."""

    def take(self, data: bytes, offsets: Offsets) -> None:
        """Add the messages that begin at `offsets`; all of them or, with `DamagedError`, none."""
        ...

    def columns(self) -> dict[str, Array]:
        """Return all that was added."""
        ...


def make_collector(schema: Schema, capacity: int) -> Collector:
    """Return the collector that suits a message definition; `capacity` messages are expected."""
    if schema.name == CLOUD_SCHEMA:
        return _CloudCollector(schema)
    fields = schema.fields
    if all(field.type in PRIMITIVES and field.length != -1 for field in fields):
        return _FixedCollector(schema, capacity)
    return _TextCollector(schema)


def read_message(data: bytes, offset: int) -> tuple[int, int, int, bytes]:
    """Return log time, publish time, sequence and payload of the message at `offset`; `DamagedError` if none is."""
    head = _gather_heads(data, np.array([offset]))[0]
    times = int(head["log_time_ns"]), int(head["publish_time_ns"])
    return *times, int(head["sequence"]), _payload(data, offset, int(head["length"]))


class _FixedCollector:
    """Messages that are all of one size."""

    def __init__(self, schema: Schema, capacity: int) -> None:
        layout = Layout.of(schema)
        if layout.size > LARGEST_LAYOUT:
            raise CdrError(f"{schema.name} has {layout.size} bytes; {LARGEST_LAYOUT} is the limit")
        self._size = layout.size
        self._record = _join_head(_without_vectors(layout.dtype))
        # a field called as one of the head's, the robot's own sequence, takes its place: it has more bits
        self._arrays: dict[str, Array] = {name: np.empty(capacity, kind) for name, kind in HEAD_COLUMNS.items()}
        for leaf in layout.leaves:
            kind = layout.dtype[leaf.path]
            dtype = np.dtype(bool) if leaf.code == "?" else kind.base
            self._arrays[leaf.path] = np.empty((capacity, *kind.shape), dtype)
        self._targets = {name: _by_row(array) for name, array in self._arrays.items()}
        self._names = frozenset(layout.dtype.names or ())
        self._filled = 0

    def take(self, data: bytes, offsets: Offsets) -> None:
        records = _gather(data, offsets, self._record)
        heads, rows = records["head"], records["payload"]
        if (heads["opcode"] != _MESSAGE).any():
            raise DamagedError("its index does not point at messages")
        if (heads["length"] != _OWN_HEAD + self._size).any():
            raise DamagedError("a message is not as long as its definition says")
        if (records["encoding"] != _CDR_HEADER).any():
            raise DamagedError("a message is not little-endian CDR")
        end = self._filled + len(rows)
        if end > len(self._arrays["log_time_ns"]):
            raise DamagedError("it holds more messages than its index says")
        for name, target in self._targets.items():
            target[self._filled : end] = rows[name] if name in self._names else heads[name]
        self._filled = end

    def columns(self) -> dict[str, Array]:
        return {name: array[: self._filled] for name, array in self._arrays.items()}


class _CloudCollector:
    """Point clouds: all at once where they differ in nothing but stamp and points, as ours do, else one by one."""

    def __init__(self, schema: Schema) -> None:
        self._schema = schema
        self._prefix: _Prefix | None = None
        self._heads: list[Array] = []
        self._widths: list[Array] = []
        self._points = {name: [array] for name, array in _split_points(np.empty(0, POINT)).items()}

    def take(self, data: bytes, offsets: Offsets) -> None:
        heads = _gather_heads(data, offsets)
        try:
            widths, points = self._take_alike(data, offsets, heads)
        except CdrError:
            widths, points = self._take_each(data, offsets, heads)
        self._heads.append(heads)
        self._widths.append(widths)
        for name, array in _split_points(points).items():
            self._points[name].append(array)

    def _take_alike(self, data: bytes, offsets: Offsets, heads: Array) -> tuple[npt.NDArray[np.int64], Array]:
        """Return numbers of points and points; `CdrError` if a message is not laid out as ours are."""
        if self._prefix is None:
            self._prefix = _Prefix.of(self._schema, _payload(data, int(offsets[0]), int(heads["length"][0])))
        size = self._prefix.size
        if (heads["length"] < _OWN_HEAD + size + CLOUD_TAIL_SIZE).any():
            raise CdrError("a point cloud is shorter than its own head")
        widths = self._prefix.read_widths(_gather_bytes(data, offsets + MESSAGE_HEAD.itemsize, size))
        if (heads["length"] != _OWN_HEAD + size + POINT.itemsize * widths + CLOUD_TAIL_SIZE).any():
            raise CdrError("a point cloud is not as long as its points")
        ends = np.cumsum(widths)
        starts = np.repeat(offsets + MESSAGE_HEAD.itemsize + size - POINT.itemsize * (ends - widths), widths)
        return widths, _gather(data, starts + POINT.itemsize * np.arange(len(starts)), POINT)

    def _take_each(self, data: bytes, offsets: Offsets, heads: Array) -> tuple[npt.NDArray[np.int64], Array]:
        """Decode one by one what another program, or another version, has laid out in its own way."""
        places = zip(offsets.tolist(), heads["length"].tolist(), strict=True)
        try:
            clouds = [read_points(decode(self._schema, _payload(data, *place))) for place in places]
        except CdrError as error:
            raise DamagedError(str(error)) from error
        return np.array([len(cloud) for cloud in clouds], np.int64), np.concatenate([np.empty(0, POINT), *clouds])

    def columns(self) -> dict[str, Array]:
        heads = np.concatenate([np.empty(0, MESSAGE_HEAD), *self._heads])
        widths = np.concatenate([np.empty(0, np.int64), *self._widths])
        offsets = np.zeros(len(widths) + 1, np.int64)
        np.cumsum(widths, out=offsets[1:])
        points = {name: np.concatenate(self._points.pop(name)) for name in list(self._points)}
        return _head_columns(heads) | points | {"offsets": offsets}


def _split_points(points: Array) -> dict[str, Array]:
    return {
        "points_m": points.view("<f4").reshape(len(points), POINT.itemsize // 4)[:, :3].copy(),
        "residual_m": points["residual"].copy(),
        "ids": points["id"].copy(),
        "flags": points["flags"].copy(),
    }


class _Prefix:
    """What stands before the points, in every message of a file the same but for stamp and sizes."""

    def __init__(self, example: npt.NDArray[np.uint8], layout: Layout) -> None:
        self.size = len(example)
        self._width_at = layout.offset_of("width")
        self._length_at = layout.offset_of("data.length")
        self._constant = np.full(self.size // 4, 0xFFFFFFFF, np.uint32)
        for path in ("header.stamp.sec", "header.stamp.nanosec", "width", "row_step", "data.length"):
            self._constant[layout.offset_of(path) // 4] = 0
        self._expected = example.view(np.uint32)

    @classmethod
    def of(cls, schema: Schema, example: bytes) -> _Prefix:
        verify_cloud(decode(schema, example))
        layout = Layout.of(schema, example)
        return cls(np.frombuffer(example[: layout.offset_of("data")], np.uint8), layout)

    def read_widths(self, prefixes: npt.NDArray[np.uint8]) -> npt.NDArray[np.int64]:
        """Return the number of points of each message."""
        # all that stands before the points is words of 4 bytes, for the last of it is the points' number of bytes
        if ((prefixes.view(np.uint32) ^ self._expected) & self._constant).any():
            raise CdrError("the point clouds are not all laid out alike")
        widths = _read_u32(prefixes, self._width_at)
        if (_read_u32(prefixes, self._length_at) != widths * POINT.itemsize).any():
            raise CdrError("a point cloud's size contradicts its number of points")
        return widths


class _TextCollector:
    """Messages that hold texts, decoded one by one: there are few of them."""

    def __init__(self, schema: Schema) -> None:
        self._schema = schema
        example = encode(schema, {})
        self._numbers = {leaf.path: np.dtype("<" + leaf.code) for leaf in Layout.of(schema, example).leaves}
        self._values: dict[str, list[Any]] = {path: [] for path in decode(schema, example)}
        self._heads: list[Array] = []

    def take(self, data: bytes, offsets: Offsets) -> None:
        heads = _gather_heads(data, offsets)
        lengths = heads["length"].tolist()
        try:
            decoded = [
                decode(self._schema, _payload(data, offset, length))
                for offset, length in zip(offsets.tolist(), lengths, strict=True)
            ]
        except CdrError as error:
            raise DamagedError(str(error)) from error
        for path, values in self._values.items():
            values.extend(message.get(path) for message in decoded)
        self._heads.append(heads)

    def columns(self) -> dict[str, Array]:
        columns = _head_columns(np.concatenate([np.empty(0, MESSAGE_HEAD), *self._heads]))
        for path, values in self._values.items():
            columns[path.replace(".", "_")] = np.array(values, self._numbers.get(path, np.dtype(object)))
        return columns


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


def _payload(data: bytes, offset: int, length: int) -> bytes:
    return data[offset + MESSAGE_HEAD.itemsize : offset + MESSAGE_HEAD.itemsize + length - _OWN_HEAD]


def _read_u32(rows: npt.NDArray[np.uint8], start: int) -> npt.NDArray[np.int64]:
    return np.ascontiguousarray(rows[:, start : start + 4]).view("<u4")[:, 0].astype(np.int64)


def _head_columns(heads: Array) -> dict[str, Array]:
    return {name: heads[name].astype(kind) for name, kind in HEAD_COLUMNS.items()}


def _gather(data: bytes, offsets: Offsets, dtype: np.dtype[Any]) -> Array:
    """Copy out one record of `dtype` at each offset."""
    n_places = len(data) - dtype.itemsize + 1
    if len(offsets) == 0:
        return np.empty(0, dtype)
    if n_places <= int(offsets.max()) or int(offsets.min()) < 0:
        raise DamagedError("a message goes beyond it")
    # copied as bytes without fields: numpy copies a record with fields one field after the other
    places: Array = np.ndarray((n_places,), f"V{dtype.itemsize}", buffer=data, strides=(1,))
    return places[offsets].view(dtype)


def _gather_bytes(data: bytes, offsets: Offsets, size: int) -> npt.NDArray[np.uint8]:
    """Copy out `size` bytes at each offset, one row for each."""
    return _gather(data, offsets, np.dtype(f"V{size}")).view(np.uint8).reshape(len(offsets), size)


def _gather_heads(data: bytes, offsets: Offsets) -> Array:
    heads = _gather(data, offsets, MESSAGE_HEAD)
    lengths = heads["length"]
    if (heads["opcode"] != _MESSAGE).any() or (lengths < _OWN_HEAD).any() or (lengths > len(data)).any():
        raise DamagedError("its index does not point at messages")
    if (offsets + 9 + lengths.astype(np.int64) > len(data)).any():
        raise DamagedError("a message goes beyond it")
    return heads
