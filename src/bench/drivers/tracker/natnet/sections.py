"""The parts of a FRAMEOFDATA: items of equal size, and what bench does not use and keeps as it came.

From 4.1 each section tells its size in bytes. That lets newer, larger items and unknown sections pass.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from struct import Struct
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.drivers.tracker.natnet.wire import Reader, pack_text
from bench.errors import ProtocolError

__all__ = [
    "BODY",
    "EMPTY",
    "LABELED",
    "POINT",
    "MarkerSet",
    "Section",
    "pack_bodies_with_markers",
    "pack_labeled_without_residual",
    "pack_marker_sets",
    "pack_section",
    "read_bodies_with_markers",
    "read_labeled_without_residual",
    "read_marker_sets",
    "read_section",
    "read_sized_array",
    "walk_channels",
    "walk_skeleton",
    "walk_skeleton_with_markers",
]

LABELED = np.dtype(
    [("id", "<u4"), ("position_m", "<f4", (3,)), ("size_m", "<f4"), ("params", "<u2"), ("residual_m", "<f4")]
)
"""One item of the labeled markers, which hold the unlabeled points too."""
LABELED_WITHOUT_RESIDUAL = np.dtype([("id", "<u4"), ("position_m", "<f4", (3,)), ("size_m", "<f4"), ("params", "<u2")])
"""The same before NatNet 3.0."""
BODY = np.dtype(
    [("id", "<i4"), ("position_m", "<f4", (3,)), ("quaternion", "<f4", (4,)), ("error_m", "<f4"), ("params", "<u2")]
)
"""Pose of one rigid body; bit 0 of its params: tracking is valid."""
POINT = np.dtype(("<f4", (3,)))
POSE_BYTES = 32
"""Number, position and quaternion of a rigid body, after which NatNet 2 has its markers."""
BODY_END_BYTES = BODY.itemsize - POSE_BYTES
BODY_MARKER_BYTES = 20
"""Position, number and size of one of them."""

COUNT = Struct("<i")
TWO = Struct("<ii")


@dataclass(slots=True, eq=False)
class MarkerSet:
    """A named list of points. Not frozen, to be quick to make."""

    name: str
    points_m: npt.NDArray[np.float32]
    """Shape (k, 3), lab frame."""


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a frame that bench does not use, kept as it came."""

    count: int = 0
    body: bytes = b""


EMPTY = Section()


def read_sized_array(reader: Reader, dtype: np.dtype[Any]) -> npt.NDArray[Any]:
    """Read items of equal size without copying; a newer version's larger items are cut to what we know."""
    item_bytes = dtype.itemsize
    count = reader.count(item_bytes)
    size = reader.count(1)
    start = reader.advance(size)
    if size != count * item_bytes:
        return _cut_items(reader, dtype, count, start)
    return np.frombuffer(reader.data, dtype, count, start)


def _cut_items(reader: Reader, dtype: np.dtype[Any], count: int, start: int) -> npt.NDArray[Any]:
    size = reader.offset - start
    if count == 0 or size % count or size < count * dtype.itemsize:
        raise ProtocolError(f"A NatNet FRAMEOFDATA has a section of {size} bytes for {count} items at byte {start}.")
    items = np.frombuffer(reader.data, np.uint8, size, start).reshape(count, size // count)
    return np.frombuffer(items[:, : dtype.itemsize].tobytes(), dtype)


def read_marker_sets(reader: Reader, sized: bool) -> tuple[MarkerSet, ...]:
    count = reader.count(5)
    end = reader.count(1) + reader.offset if sized else None
    sets = tuple([MarkerSet(reader.text(), reader.array(POINT)) for _ in range(count)])
    if end is not None and reader.offset != end:
        raise ProtocolError(f"The marker sets of a NatNet FRAMEOFDATA end at byte {reader.offset}, not at {end}.")
    return sets


def read_section(reader: Reader, walk: Callable[[Reader], None] | None) -> Section:
    """Read a section we keep as it came: by its size, or where it tells none by walking through its items."""
    if walk is None:
        count = reader.count(0)
        size = reader.count(1)
        return Section(count, reader.take(size)) if count or size else EMPTY
    count = reader.count(8)
    if count == 0:
        return EMPTY
    start = reader.offset
    for _ in range(count):
        walk(reader)
    return Section(count, reader.data[start : reader.offset])


def walk_skeleton(reader: Reader) -> None:
    reader.advance(4)
    reader.advance(reader.count(BODY.itemsize) * BODY.itemsize)


def walk_skeleton_with_markers(reader: Reader) -> None:
    reader.advance(4)
    for _ in range(reader.count(BODY.itemsize)):
        _read_body_markers(reader)


def walk_channels(reader: Reader) -> None:
    reader.advance(4)
    for _ in range(reader.count(4)):
        reader.advance(reader.count(4) * 4)


def read_labeled_without_residual(reader: Reader) -> npt.NDArray[np.void]:
    """Read the labeled markers of NatNet 2: their residual is NaN."""
    found = reader.array(LABELED_WITHOUT_RESIDUAL)
    labeled = np.empty(len(found), dtype=LABELED)
    for name in LABELED_WITHOUT_RESIDUAL.names or ():
        labeled[name] = found[name]
    labeled["residual_m"] = np.nan
    return labeled


def read_bodies_with_markers(reader: Reader) -> tuple[npt.NDArray[np.void], tuple[Section, ...]]:
    """Read the rigid bodies of NatNet 2: poses, and the markers of each as they came."""
    found = [_read_body_markers(reader) for _ in range(reader.count(BODY.itemsize + COUNT.size))]
    poses = np.frombuffer(b"".join([pose for pose, _ in found]), dtype=BODY)
    return poses, tuple([markers for _, markers in found])


def _read_body_markers(reader: Reader) -> tuple[bytes, Section]:
    pose = reader.take(POSE_BYTES)
    count = reader.count(BODY_MARKER_BYTES)
    markers = Section(count, reader.take(count * BODY_MARKER_BYTES))
    return pose + reader.take(BODY_END_BYTES), markers


def pack_section(count: int, body: bytes, sized: bool) -> bytes:
    return (TWO.pack(count, len(body)) if sized else COUNT.pack(count)) + body


def pack_marker_sets(sets: tuple[MarkerSet, ...], sized: bool) -> bytes:
    return pack_section(len(sets), b"".join([_pack_marker_set(one) for one in sets]), sized)


def _pack_marker_set(one: MarkerSet) -> bytes:
    return pack_text(one.name) + COUNT.pack(len(one.points_m)) + one.points_m.astype("<f4", copy=False).tobytes()


def pack_labeled_without_residual(labeled: npt.NDArray[np.void]) -> bytes:
    old = np.empty(len(labeled), dtype=LABELED_WITHOUT_RESIDUAL)
    for name in LABELED_WITHOUT_RESIDUAL.names or ():
        old[name] = labeled[name]
    return pack_section(len(old), old.tobytes(), sized=False)


def pack_bodies_with_markers(bodies: npt.NDArray[np.void], markers: tuple[Section, ...]) -> bytes:
    """Pack rigid bodies as NatNet 2 has them; bodies beyond `markers` have none."""
    parts = [COUNT.pack(len(bodies))]
    for index, body in enumerate(bodies):
        pose, one = body.tobytes(), markers[index] if index < len(markers) else EMPTY
        parts += [pose[:POSE_BYTES], COUNT.pack(one.count), one.body, pose[POSE_BYTES:]]
    return b"".join(parts)
