"""The markers of one exposure as `sensor_msgs/msg/PointCloud2`, the one point message every viewer draws.

Frame and field names are always the same, so all that changes between two messages stands at fixed places, and the
points of a whole chunk can be read at once.
"""

from __future__ import annotations

import itertools
import struct
from collections.abc import Mapping
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.model import NO_ID, TrackerFrame
from bench.recording.messages.cdr import CdrError, Layout, decode, encode
from bench.recording.messages.schemas import load_schema

__all__ = ["CLOUD_SCHEMA", "CLOUD_TAIL_SIZE", "POINT", "encode_cloud", "read_points", "split_stamp", "verify_cloud"]

CLOUD_SCHEMA = "sensor_msgs/msg/PointCloud2"
POINT = np.dtype([("x", "<f4"), ("y", "<f4"), ("z", "<f4"), ("residual", "<f4"), ("id", "<u4"), ("flags", "<u4")])
"""One point as it stands in the message; lengths in metres, lab frame."""

_FLOAT32, _UINT32 = 7, 6  # sensor_msgs/msg/PointField
_KINDS: Mapping[int, str] = {_FLOAT32: "f4", 8: "f8", 2: "u1", 4: "u2", _UINT32: "u4"}
"""Of a field's number there: those of the kinds that ours have."""
_NS_PER_S = 1_000_000_000
_LAST_SECOND = 2**31 - 1  # builtin_interfaces/msg/Time counts seconds in an int32


def _empty_cloud() -> bytes:
    kinds = {name: POINT[name].kind for name in POINT.names or ()}
    fields = [
        {"name": name, "offset": 4 * i, "datatype": _UINT32 if kind == "u" else _FLOAT32, "count": 1}
        for i, (name, kind) in enumerate(kinds.items())
    ]
    values: dict[str, Any] = {
        "header": {"frame_id": "lab"},
        "height": 1,
        "fields": fields,
        "point_step": POINT.itemsize,
    }
    return encode(load_schema(CLOUD_SCHEMA), values)


_EMPTY = _empty_cloud()
_LAYOUT = Layout.of(load_schema(CLOUD_SCHEMA), _EMPTY)
_POINTS_AT = _LAYOUT.offset_of("data")
_WIDTH_AT = _LAYOUT.offset_of("width")
_STAMP_AT = _LAYOUT.offset_of("header.stamp.sec")
_ROW_AT = _LAYOUT.offset_of("row_step")
_HEAD, _TAIL = _EMPTY[:_POINTS_AT], _EMPTY[_POINTS_AT:]
CLOUD_TAIL_SIZE = len(_TAIL)
"""Bytes after the points: `is_dense`."""
_CHANGING = {"header.stamp.sec", "header.stamp.nanosec", "header.frame_id", "width", "row_step", "data"}
_STAMP = struct.Struct("<iI")
_WIDTH = struct.Struct("<I")
_ROW = struct.Struct("<II")  # row_step, then the length of the data: no padding between two uint32


def encode_cloud(frame: TrackerFrame) -> bytes:
    """Encode the points of one frame.

    Raises
    ------
    ValueError
        The frame's arrays are not of the same length.
    """
    points = _pack_points(frame)
    out = bytearray(_HEAD)
    _STAMP.pack_into(out, _STAMP_AT, *split_stamp(frame.capture_ns))
    _WIDTH.pack_into(out, _WIDTH_AT, len(points))
    _ROW.pack_into(out, _ROW_AT, points.nbytes, points.nbytes)
    return b"".join((out, points.data, _TAIL))


def verify_cloud(values: Mapping[str, Any]) -> None:
    """Raise `CdrError` if a decoded cloud has other fields than ours, or lays them out in another way."""
    ours = decode(load_schema(CLOUD_SCHEMA), _EMPTY)
    for path in ours.keys() | values.keys():
        if path not in _CHANGING and ours.get(path) != values.get(path):
            raise CdrError(f"{path} of a point cloud is {values.get(path)!r} instead of {ours.get(path)!r}")


def read_points(values: Mapping[str, Any]) -> npt.NDArray[Any]:
    """Return the points of a decoded cloud as `POINT` records, wherever in a point their fields stand.

    What the cloud does not have of a point is missing: residual NaN, id `NO_ID`, flags 0.

    Raises
    ------
    CdrError
        It has no positions, or its sizes contradict each other.
    """
    try:
        source = np.frombuffer(values["data"], _find_fields(values))
        if len(source) != values["width"] * values["height"]:
            raise CdrError(f"{len(source)} points where {values['width']} times {values['height']} are named")
    except (LookupError, TypeError, ValueError) as error:
        raise CdrError(f"a point cloud cannot be understood: {error}") from error
    points = np.zeros(len(source), POINT)
    points["residual"], points["id"] = np.nan, NO_ID
    with np.errstate(over="ignore"):  # of a float64 that is no length
        for name in source.dtype.names or ():
            points[name] = source[name]
    return points


def _find_fields(values: Mapping[str, Any]) -> np.dtype[Any]:
    """Return a point as it stands in the message, of its fields those that are ours."""
    order = ">" if values["is_bigendian"] else "<"
    formats, offsets = {}, {}
    for i in itertools.count():
        name = values.get(f"fields.{i}.name")
        if name is None:
            break
        kind = _KINDS.get(values[f"fields.{i}.datatype"])
        if name in (POINT.names or ()) and kind is not None and np.dtype(kind).kind == POINT[name].kind:
            formats[name], offsets[name] = order + kind, values[f"fields.{i}.offset"]
    if missing := {"x", "y", "z"} - formats.keys():
        raise CdrError(f"it has no {', '.join(sorted(missing))}")
    layout: Any = {
        "names": list(formats),
        "formats": list(formats.values()),
        "offsets": list(offsets.values()),
        "itemsize": values["point_step"],
    }
    point: np.dtype[Any] = np.dtype(layout)
    return point


def split_stamp(unix_ns: int) -> tuple[int, int]:
    """Return seconds and nanoseconds as a ROS stamp holds them, times outside its range at its bounds."""
    sec, nanosec = divmod(max(unix_ns, 0), _NS_PER_S)
    return min(sec, _LAST_SECOND), nanosec


def _pack_points(frame: TrackerFrame) -> npt.NDArray[np.uint32]:
    n = len(frame.points_m)
    if not len(frame.residual_m) == len(frame.ids) == len(frame.flags) == n:
        raise ValueError(f"frame {frame.frame_number}: {n} points, but not as many residuals, ids and flags")
    lengths_m = np.empty((n, 6), np.float32)  # copied as they are, even the payload of a NaN
    lengths_m[:, :3] = frame.points_m
    lengths_m[:, 3] = frame.residual_m
    packed = lengths_m.view(np.uint32)
    packed[:, 4] = frame.ids
    packed[:, 5] = frame.flags
    return packed
