"""Point clouds to numpy columns, those of a whole chunk at once where they are laid out as ours are."""

from __future__ import annotations

from typing import Any

import numpy as np
import numpy.typing as npt

from bench.recording.container.chunks import Data, Offsets
from bench.recording.container.contents import DamagedError
from bench.recording.messages.cdr import CdrError, Layout, decode
from bench.recording.messages.pointcloud import CLOUD_TAIL_SIZE, POINT, read_points, verify_cloud
from bench.recording.messages.schemas import Schema
from bench.recording.reading.columns import HEAD_COLUMNS, Array, allocate_columns
from bench.recording.reading.gathering import MESSAGE_HEAD, OWN_HEAD, gather, gather_bytes, gather_heads, payload_of

__all__ = ["CloudCollector"]

_COLUMNS: dict[str, Any] = {
    "points_m": ("<f4", (3,)),
    "residual_m": "<f4",
    "ids": "<u4",
    "flags": "<u4",
}
_MOVED = np.dtype([("points_m", "V12"), ("residual_m", "<f4"), ("ids", "<u4"), ("flags", "<u4")])
"""A point as it is copied: numpy moves the three coordinates as bytes at once, and not number by number."""


SPARE = 1.05
"""Room for points, times what all frames take if the rest has as many each; what is never filled takes no memory."""
MOST_AHEAD = 64.0
"""Times the points that are there: a few large frames do not ask for more than a machine has."""


class CloudCollector:
    """Point clouds: all at once where they differ in nothing but stamp and points, as ours do, else one by one."""

    def __init__(self, schema: Schema, capacity: int) -> None:
        self._schema = schema
        self._prefix: _Prefix | None = None
        self._frames = allocate_columns({**HEAD_COLUMNS, "n_points": np.int64}, capacity)
        self._n_frames = 0
        self._points = _Points()

    def take(self, data: Data, offsets: Offsets) -> None:
        heads = gather_heads(data, offsets)
        end = self._n_frames + len(heads)
        if end > len(self._frames["n_points"]):
            raise DamagedError("it holds more messages than its index says")
        try:
            widths, points = self._take_alike(data, offsets, heads)
        except CdrError:
            widths, points = self._take_each(data, offsets, heads)
        for name in HEAD_COLUMNS:
            self._frames[name][self._n_frames : end] = heads[name]
        self._frames["n_points"][self._n_frames : end] = widths
        self._n_frames = end
        self._points.add(points, self._n_frames / len(self._frames["n_points"]))

    def mark(self) -> tuple[int, ...]:
        return self._n_frames, self._points.filled

    def return_to(self, mark: tuple[int, ...]) -> None:
        self._n_frames, self._points.filled = mark

    def _take_alike(self, data: Data, offsets: Offsets, heads: Array) -> tuple[npt.NDArray[np.int64], Array]:
        """Return numbers of points and points; `CdrError` if a message is not laid out as ours are."""
        if self._prefix is None:
            self._prefix = _Prefix.of(self._schema, payload_of(data, int(offsets[0]), int(heads["length"][0])))
        size = self._prefix.size
        if (heads["length"] < OWN_HEAD + size + CLOUD_TAIL_SIZE).any():
            raise CdrError("a point cloud is shorter than its own head")
        widths = self._prefix.read_widths(gather_bytes(data, offsets + MESSAGE_HEAD.itemsize, size))
        if (heads["length"] != OWN_HEAD + size + POINT.itemsize * widths + CLOUD_TAIL_SIZE).any():
            raise CdrError("a point cloud is not as long as its points")
        ends = np.cumsum(widths)
        starts = np.repeat(offsets + MESSAGE_HEAD.itemsize + size - POINT.itemsize * (ends - widths), widths)
        return widths, gather(data, starts + np.arange(0, POINT.itemsize * len(starts), POINT.itemsize), POINT)

    def _take_each(self, data: Data, offsets: Offsets, heads: Array) -> tuple[npt.NDArray[np.int64], Array]:
        """Decode one by one what another program, or another version, has laid out in its own way."""
        places = zip(offsets.tolist(), heads["length"].tolist(), strict=True)
        try:
            clouds = [read_points(decode(self._schema, payload_of(data, *place))) for place in places]
        except CdrError as error:
            raise DamagedError(str(error)) from error
        return np.array([len(cloud) for cloud in clouds], np.int64), np.concatenate([np.empty(0, POINT), *clouds])

    def columns(self) -> dict[str, Array]:
        offsets = np.zeros(self._n_frames + 1, np.int64)
        np.cumsum(self._frames["n_points"][: self._n_frames], out=offsets[1:])
        heads = {name: self._frames[name][: self._n_frames] for name in HEAD_COLUMNS}
        return heads | self._points.columns() | {"offsets": offsets}


class _Points:
    """Points one after the other, in columns that grow where there are more than the frames so far promise."""

    def __init__(self) -> None:
        self.filled = 0
        self._capacity = 0
        self._arrays = allocate_columns(_COLUMNS, 0)

    def add(self, points: Array, share: float) -> None:
        """Append points; with them this share of all frames is there."""
        end = self.filled + len(points)
        if end > self._capacity:
            self._capacity = int(end * min(max(2.0, SPARE / share), MOST_AHEAD))
            known, self._arrays = self.columns(), allocate_columns(_COLUMNS, self._capacity)
            for name, array in known.items():
                self._arrays[name][: self.filled] = array
        moved = points.view(_MOVED)
        for name, array in self._arrays.items():
            target = array.view("V12")[:, 0] if array.ndim == 2 else array
            target[self.filled : end] = moved[name]
        self.filled = end

    def columns(self) -> dict[str, Array]:
        return {name: array[: self.filled] for name, array in self._arrays.items()}


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
    def of(cls, schema: Schema, example: Data) -> _Prefix:
        verify_cloud(decode(schema, example))
        layout = Layout.of(schema, bytes(example))
        return cls(np.frombuffer(bytes(example[: layout.offset_of("data")]), np.uint8), layout)

    def read_widths(self, prefixes: npt.NDArray[np.uint8]) -> npt.NDArray[np.int64]:
        """Return the number of points of each message."""
        # all that stands before the points is words of 4 bytes, for the last of it is the points' number of bytes
        words = prefixes.view(np.uint32)
        if ((words ^ self._expected) & self._constant).any():
            raise CdrError("the point clouds are not all laid out alike")
        widths = words[:, self._width_at // 4].astype(np.int64)
        if (words[:, self._length_at // 4] != widths * POINT.itemsize).any():
            raise CdrError("a point cloud's size contradicts its number of points")
        return widths
