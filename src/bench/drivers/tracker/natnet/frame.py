"""FRAMEOFDATA: everything the cameras saw in one exposure, NatNet 3.0 to 4.3.

From 4.1 each section tells its size in bytes. That lets newer, larger items and unknown sections pass; the four zero
bytes at the end prove that nothing was misread.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from struct import Struct
from typing import Any

import numpy as np
import numpy.typing as npt

from bench.drivers.tracker.natnet.wire import Message, Reader, Version, encode_packet, pack_text
from bench.errors import ProtocolError

__all__ = [
    "BITSTREAM_CHANGED",
    "BODY",
    "EDIT_MODE",
    "HAS_MODEL",
    "LABELED",
    "MODELS_CHANGED",
    "OLDEST_VERSION",
    "RECORDING",
    "Frame",
    "MarkerSet",
    "Section",
    "decode_frame",
    "encode_frame",
]

OLDEST_VERSION = (3, 0)
"""Older frames carry no camera stamps, without which they cannot be put on the run's time line."""
SIZES_SINCE = (4, 1)
ASSETS_SINCE = (4, 1)
PTP_SINCE = (4, 1)

LABELED = np.dtype(
    [("id", "<u4"), ("position_m", "<f4", (3,)), ("size_m", "<f4"), ("params", "<u2"), ("residual_m", "<f4")]
)
"""One item of the labeled markers, which hold the unlabeled points too."""
BODY = np.dtype(
    [("id", "<i4"), ("position_m", "<f4", (3,)), ("quaternion", "<f4", (4,)), ("error_m", "<f4"), ("params", "<u2")]
)
"""Pose of one rigid body; bit 0 of its params: tracking is valid."""
POINT = np.dtype(("<f4", (3,)))

HAS_MODEL = 0x08
"""Bit of a marker's params: it belongs to a rigid body."""
RECORDING, MODELS_CHANGED, EDIT_MODE, BITSTREAM_CHANGED = 1, 2, 4, 8
"""Bits of a frame's params."""

COUNT = Struct("<i")
TWO = Struct("<ii")
SUFFIX = Struct("<IIdQQQ")
"""Timecode, subframe, timestamp, and the three camera stamps."""
SHORT_END = Struct("<Hi")
LONG_END = Struct("<IIHi")
"""The end with the two numbers of a PTP time. Published clients disagree on the version that brings them in, so the
bytes that are left decide."""


@dataclass(frozen=True, slots=True, eq=False)
class MarkerSet:
    """A named list of points."""

    name: str
    points_m: npt.NDArray[np.float32]
    """Shape (k, 3), lab frame."""


@dataclass(frozen=True, slots=True)
class Section:
    """A part of a frame that bench does not use, kept as it came."""

    count: int = 0
    body: bytes = b""


EMPTY = Section()


@dataclass(frozen=True, slots=True, eq=False)
class Frame:
    """One FRAMEOFDATA."""

    frame_number: int
    labeled: npt.NDArray[np.void]
    """`LABELED`: every point, of rigid bodies and of none."""
    bodies: npt.NDArray[np.void]
    """`BODY`."""
    other_m: npt.NDArray[np.float32]
    """Shape (k, 3), lab frame. Called unlabeled in the manual, but Motive 2.1 puts the rigid bodies' markers here."""
    timestamp_s: float
    """Seconds since the tracker's software started."""
    mid_exposure: int
    """Ticks of the tracker's clock; 0 with USB cameras."""
    data_received: int
    """Ticks when the camera data was complete."""
    transmit: int
    """Ticks when the packet was handed to the network."""
    marker_sets: tuple[MarkerSet, ...] = ()
    skeletons: Section = EMPTY
    assets: Section = EMPTY
    force_plates: Section = EMPTY
    devices: Section = EMPTY
    timecode: tuple[int, int] = (0, 0)
    ptp: tuple[int, int] = (0, 0)
    """Seconds and fraction of a PTP clock; zero without one."""
    params: int = 0
    newer: tuple[Section, ...] = ()
    """Sections of a version newer than this decoder."""


def decode_frame(payload: bytes, version: Version) -> Frame:
    """Decode a FRAMEOFDATA.

    Parameters
    ----------
    payload : bytes
        The packet without its header; at most its size is allocated.
    version : tuple of int
        Bitstream version, 3.0 or newer.

    Raises
    ------
    ProtocolError
        Cut short, corrupted, or of another version.
    """
    reader = Reader(payload, "FRAMEOFDATA")
    sized = version >= SIZES_SINCE
    number = reader.integer()
    marker_sets = _read_marker_sets(reader, sized)
    other = _read_array(reader, POINT, sized)
    bodies = _read_array(reader, BODY, sized)
    skeletons = _read_section(reader, sized, _walk_skeleton)
    assets = _read_section(reader, sized, None) if version >= ASSETS_SINCE else EMPTY
    labeled = _read_array(reader, LABELED, sized)
    force_plates = _read_section(reader, sized, _walk_channels)
    devices = _read_section(reader, sized, _walk_channels)
    newer = _read_newer(reader) if sized and reader.remaining > SUFFIX.size + LONG_END.size else ()
    timecode, subframe, timestamp, mid_exposure, received, transmit = reader.unpack(SUFFIX)
    ptp, params = _read_end(reader)
    return Frame(
        frame_number=number,
        labeled=labeled,
        bodies=bodies,
        other_m=other,
        timestamp_s=timestamp,
        mid_exposure=int(mid_exposure),
        data_received=int(received),
        transmit=int(transmit),
        marker_sets=marker_sets,
        skeletons=skeletons,
        assets=assets,
        force_plates=force_plates,
        devices=devices,
        timecode=(int(timecode), int(subframe)),
        ptp=ptp,
        params=params,
        newer=newer,
    )


def encode_frame(frame: Frame, version: Version) -> bytes:
    """Encode a whole FRAMEOFDATA packet, the inverse of `decode_frame` for 3.0 to 4.3."""
    sized = version >= SIZES_SINCE
    sets = b"".join(_pack_marker_set(one) for one in frame.marker_sets)
    parts = [
        COUNT.pack(frame.frame_number),
        _pack_section(len(frame.marker_sets), sets, sized),
        _pack_section(len(frame.other_m), frame.other_m.astype("<f4", copy=False).tobytes(), sized),
        _pack_section(len(frame.bodies), frame.bodies.tobytes(), sized),
        _pack_section(frame.skeletons.count, frame.skeletons.body, sized),
        _pack_section(frame.assets.count, frame.assets.body, sized) if version >= ASSETS_SINCE else b"",
        _pack_section(len(frame.labeled), frame.labeled.tobytes(), sized),
        _pack_section(frame.force_plates.count, frame.force_plates.body, sized),
        _pack_section(frame.devices.count, frame.devices.body, sized),
        *(_pack_section(one.count, one.body, sized) for one in frame.newer),
        SUFFIX.pack(*frame.timecode, frame.timestamp_s, frame.mid_exposure, frame.data_received, frame.transmit),
        LONG_END.pack(*frame.ptp, frame.params, 0) if version >= PTP_SINCE else SHORT_END.pack(frame.params, 0),
    ]
    return encode_packet(Message.FRAMEOFDATA, b"".join(parts))


def _pack_section(count: int, body: bytes, sized: bool) -> bytes:
    return (TWO.pack(count, len(body)) if sized else COUNT.pack(count)) + body


def _pack_marker_set(one: MarkerSet) -> bytes:
    return pack_text(one.name) + COUNT.pack(len(one.points_m)) + one.points_m.astype("<f4", copy=False).tobytes()


def _section_end(reader: Reader) -> int:
    """Read a section's size and return where the section ends."""
    size = reader.count(1)
    return reader.offset + size


def _read_array(reader: Reader, dtype: np.dtype[Any], sized: bool) -> npt.NDArray[Any]:
    """Read a section of items of equal size without copying; a newer version's larger items are cut to what we know."""
    count = reader.count(dtype.itemsize)
    size = reader.count(1) if sized else count * dtype.itemsize
    start = reader.advance(size)
    if size == count * dtype.itemsize:
        return np.frombuffer(reader.data, dtype, count, start)
    if count == 0 or size % count or size < count * dtype.itemsize:
        raise ProtocolError(f"A NatNet FRAMEOFDATA has a section of {size} bytes for {count} items at byte {start}.")
    items = np.frombuffer(reader.data, np.uint8, size, start).reshape(count, size // count)
    return np.frombuffer(items[:, : dtype.itemsize].tobytes(), dtype)


def _read_marker_sets(reader: Reader, sized: bool) -> tuple[MarkerSet, ...]:
    count = reader.count(5)
    end = _section_end(reader) if sized else None
    sets = tuple(_read_marker_set(reader) for _ in range(count))
    if end is not None and reader.offset != end:
        raise ProtocolError(f"The marker sets of a NatNet FRAMEOFDATA end at byte {reader.offset}, not at {end}.")
    return sets


def _read_marker_set(reader: Reader) -> MarkerSet:
    name = reader.text()
    count = reader.count(POINT.itemsize)
    return MarkerSet(name, np.frombuffer(reader.data, POINT, count, reader.advance(count * POINT.itemsize)))


def _read_section(reader: Reader, sized: bool, walk: Callable[[Reader], None] | None) -> Section:
    """Read a section we keep as it came: by its size, or before 4.1 by walking through its items."""
    if sized or walk is None:
        count = reader.count(0)
        return Section(count, reader.take(reader.count(1)))
    count = reader.count(8)
    start = reader.offset
    for _ in range(count):
        walk(reader)
    return Section(count, reader.data[start : reader.offset])


def _walk_skeleton(reader: Reader) -> None:
    reader.advance(4)
    reader.advance(reader.count(BODY.itemsize) * BODY.itemsize)


def _walk_channels(reader: Reader) -> None:
    reader.advance(4)
    for _ in range(reader.count(4)):
        reader.advance(reader.count(4) * 4)


def _read_newer(reader: Reader) -> tuple[Section, ...]:
    found = []
    while reader.remaining > SUFFIX.size + LONG_END.size:
        found.append(_read_section(reader, True, None))
    return tuple(found)


def _read_end(reader: Reader) -> tuple[tuple[int, int], int]:
    """Read what follows the stamps: its size tells whether a PTP time is there."""
    ptp = (0, 0)
    if reader.remaining == LONG_END.size:
        seconds, fraction, params, tag = reader.unpack(LONG_END)
        ptp = (int(seconds), int(fraction))
    elif reader.remaining == SHORT_END.size:
        params, tag = reader.unpack(SHORT_END)
    else:
        raise ProtocolError(
            f"A NatNet FRAMEOFDATA has {reader.remaining} bytes after its stamps; "
            f"{SHORT_END.size} or {LONG_END.size} are due."
        )
    if tag != 0:
        raise ProtocolError(f"A NatNet FRAMEOFDATA ends with {tag:#x} instead of four zero bytes.")
    return ptp, int(params)
