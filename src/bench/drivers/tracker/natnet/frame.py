"""FRAMEOFDATA: everything the cameras saw in one exposure, NatNet 2.9 to 4.3, and newer ones as far as they are alike.

The four zero bytes at the end prove that nothing was misread.
"""

from __future__ import annotations

from dataclasses import dataclass
from struct import Struct

import numpy as np
import numpy.typing as npt

from bench.drivers.tracker.natnet.sections import (
    BODY,
    EMPTY,
    LABELED,
    POINT,
    MarkerSet,
    Section,
    pack_bodies_with_markers,
    pack_labeled_without_residual,
    pack_marker_sets,
    pack_section,
    read_bodies_with_markers,
    read_labeled_without_residual,
    read_marker_sets,
    read_section,
    read_sized_array,
    walk_channels,
    walk_skeleton,
    walk_skeleton_with_markers,
)
from bench.drivers.tracker.natnet.wire import Message, Reader, Version, encode_packet
from bench.errors import ProtocolError

__all__ = [
    "BITSTREAM_CHANGED",
    "BODY",
    "EDIT_MODE",
    "HAS_MODEL",
    "LABELED",
    "MODELS_CHANGED",
    "NEWEST_KNOWN",
    "NO_STAMP",
    "OLDEST_VERSION",
    "RECORDING",
    "STAMPS_SINCE",
    "Frame",
    "MarkerSet",
    "Section",
    "decode_frame",
    "encode_frame",
]

OLDEST_VERSION = (2, 9)
"""Of Motive 1.9, 2015."""
STAMPS_SINCE = (3, 0)
"""Before it, a frame has no camera stamps but the time since the software's start alone."""
NO_STAMP = -1
SIZES_SINCE = (4, 1)
PTP_SINCE = (4, 1)
DEVICES_SINCE = (2, 11)
NEWEST_KNOWN = (4, 3)
"""Of newer ones, what is not known is skipped."""

HAS_MODEL = 0x08
"""Bit of a marker's params: it belongs to a rigid body."""
RECORDING, MODELS_CHANGED, EDIT_MODE, BITSTREAM_CHANGED = 1, 2, 4, 8
"""Bits of a frame's params."""

NUMBER = Struct("<i")
SUFFIX = Struct("<IIdQQQ")
"""Timecode, subframe, timestamp, and the three camera stamps."""
OLD_SUFFIX = Struct("<fIId")
"""Software latency, timecode, subframe, timestamp."""
SHORT_END = Struct("<Hi")
LONG_END = Struct("<IIHi")
"""The end with the two numbers of a PTP time. Published clients disagree on the version that brings them in, so the
bytes that are left decide."""
SHORTEST_SECTION = 8
LARGEST_TIMESTAMP_S = 1e10
SMALLEST_TIMESTAMP_S = 1e-9
"""Above 0: a whole number of ticks that is read as a timestamp is far smaller, an address in memory far larger."""


@dataclass(slots=True, eq=False)
class Frame:
    """One FRAMEOFDATA. Not frozen, though nobody changes it: that would make its making three times as slow."""

    frame_number: int
    labeled: npt.NDArray[np.void]
    """`LABELED`: every point, of rigid bodies and of none. Before NatNet 3 the residual is NaN."""
    bodies: npt.NDArray[np.void]
    """`BODY`."""
    other_m: npt.NDArray[np.float32]
    """Shape (k, 3), lab frame. Called unlabeled in the manual, but Motive 2.1 puts the rigid bodies' markers here."""
    timestamp_s: float
    """Seconds since the tracker's software started."""
    mid_exposure: int
    """Ticks of the tracker's clock; 0 with USB cameras, `NO_STAMP` before NatNet 3."""
    data_received: int
    """Ticks when the camera data was complete; `NO_STAMP` before NatNet 3."""
    transmit: int
    """Ticks when the packet was handed to the network; `NO_STAMP` before NatNet 3."""
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
    trailing: bytes = b""
    """What a newer version has between the params and the closing zeros."""
    body_markers: tuple[Section, ...] = ()
    """Before NatNet 3: the markers of each rigid body."""
    latency_s: float = 0.0
    """Before NatNet 3: software latency."""


def decode_frame(payload: bytes, version: Version) -> Frame:
    """Decode a FRAMEOFDATA.

    Parameters
    ----------
    payload : bytes
        The packet without its header; at most its size is allocated.
    version : tuple of int
        Bitstream version, 2.9 or newer.

    Raises
    ------
    ProtocolError
        Cut short, corrupted, or of another version.
    """
    reader = Reader(payload, "FRAMEOFDATA")
    if version < STAMPS_SINCE:
        return _decode_old(reader, version)
    sized = version >= SIZES_SINCE
    read_array = read_sized_array if sized else Reader.array
    number = reader.integer()
    marker_sets = read_marker_sets(reader, sized)
    other = read_array(reader, POINT)
    bodies = read_array(reader, BODY)
    skeletons = read_section(reader, None if sized else walk_skeleton)
    assets = read_section(reader, None) if sized else EMPTY  # sizes and assets came with the same version
    labeled = read_array(reader, LABELED)
    force_plates = read_section(reader, None if sized else walk_channels)
    devices = read_section(reader, None if sized else walk_channels)
    is_newer = sized and version[:2] > NEWEST_KNOWN
    newer = _read_newer(reader) if is_newer else ()
    timecode, subframe, timestamp_s, mid_exposure, received, transmit = reader.unpack(SUFFIX)
    seconds, fraction, params, trailing = _read_end(reader, is_newer)
    return Frame(
        frame_number=number,
        labeled=labeled,
        bodies=bodies,
        other_m=other,
        timestamp_s=timestamp_s,
        mid_exposure=mid_exposure,
        data_received=received,
        transmit=transmit,
        marker_sets=marker_sets,
        skeletons=skeletons,
        assets=assets,
        force_plates=force_plates,
        devices=devices,
        timecode=(timecode, subframe),
        ptp=(seconds, fraction),
        params=params,
        newer=newer,
        trailing=trailing,
    )


def encode_frame(frame: Frame, version: Version) -> bytes:
    """Encode a whole FRAMEOFDATA packet, the inverse of `decode_frame`."""
    if version < STAMPS_SINCE:
        return _encode_old(frame, version)
    sized = version >= SIZES_SINCE
    parts = [
        NUMBER.pack(frame.frame_number),
        pack_marker_sets(frame.marker_sets, sized),
        pack_section(len(frame.other_m), frame.other_m.astype("<f4", copy=False).tobytes(), sized),
        pack_section(len(frame.bodies), frame.bodies.tobytes(), sized),
        pack_section(frame.skeletons.count, frame.skeletons.body, sized),
        pack_section(frame.assets.count, frame.assets.body, sized) if sized else b"",
        pack_section(len(frame.labeled), frame.labeled.tobytes(), sized),
        pack_section(frame.force_plates.count, frame.force_plates.body, sized),
        pack_section(frame.devices.count, frame.devices.body, sized),
        *(pack_section(one.count, one.body, sized) for one in frame.newer),
        SUFFIX.pack(*frame.timecode, frame.timestamp_s, frame.mid_exposure, frame.data_received, frame.transmit),
        LONG_END.pack(*frame.ptp, frame.params, 0) if version >= PTP_SINCE else SHORT_END.pack(frame.params, 0),
    ]
    packed = b"".join(parts)
    if frame.trailing:
        packed = packed[: -NUMBER.size] + frame.trailing + packed[-NUMBER.size :]
    return encode_packet(Message.FRAMEOFDATA, packed)


def _decode_old(reader: Reader, version: Version) -> Frame:
    """Decode NatNet 2.9 to 2.11, which has no sizes, no residuals and no stamps, but markers inside of rigid bodies."""
    number = reader.integer()
    marker_sets = read_marker_sets(reader, sized=False)
    other = reader.array(POINT)
    bodies, body_markers = read_bodies_with_markers(reader)
    skeletons = read_section(reader, walk_skeleton_with_markers)
    labeled = read_labeled_without_residual(reader)
    force_plates = read_section(reader, walk_channels)
    devices = read_section(reader, walk_channels) if version >= DEVICES_SINCE else EMPTY
    latency_s, timecode, subframe, timestamp_s = reader.unpack(OLD_SUFFIX)
    if reader.remaining != SHORT_END.size:
        raise _wrong_end(reader.remaining, SHORT_END.size)
    _, _, params, _ = _read_end(reader, tolerant=False)
    return Frame(
        frame_number=number,
        labeled=labeled,
        bodies=bodies,
        other_m=other,
        timestamp_s=timestamp_s,
        mid_exposure=NO_STAMP,
        data_received=NO_STAMP,
        transmit=NO_STAMP,
        marker_sets=marker_sets,
        skeletons=skeletons,
        force_plates=force_plates,
        devices=devices,
        timecode=(timecode, subframe),
        params=params,
        body_markers=body_markers,
        latency_s=latency_s,
    )


def _encode_old(frame: Frame, version: Version) -> bytes:
    parts = [
        NUMBER.pack(frame.frame_number),
        pack_marker_sets(frame.marker_sets, sized=False),
        pack_section(len(frame.other_m), frame.other_m.astype("<f4", copy=False).tobytes(), sized=False),
        pack_bodies_with_markers(frame.bodies, frame.body_markers),
        pack_section(frame.skeletons.count, frame.skeletons.body, sized=False),
        pack_labeled_without_residual(frame.labeled),
        pack_section(frame.force_plates.count, frame.force_plates.body, sized=False),
        pack_section(frame.devices.count, frame.devices.body, sized=False) if version >= DEVICES_SINCE else b"",
        OLD_SUFFIX.pack(frame.latency_s, *frame.timecode, frame.timestamp_s),
        SHORT_END.pack(frame.params, 0),
    ]
    return encode_packet(Message.FRAMEOFDATA, b"".join(parts))


def _read_newer(reader: Reader) -> tuple[Section, ...]:
    """Step over the sections of a newer version: as many as leave stamps behind them that make sense."""
    found: list[Section] = []
    ends = [reader.offset]
    while reader.remaining >= SHORTEST_SECTION + SUFFIX.size + LONG_END.size:
        try:
            found.append(read_section(reader, None))
        except ProtocolError:
            break
        ends.append(reader.offset)
    while not _is_suffix(reader, ends[-1]) and found:
        found.pop()
        ends.pop()
    reader.offset = ends[-1]
    return tuple(found)


def _is_suffix(reader: Reader, start: int) -> bool:
    """Tell whether the stamps can begin here: a time above 0 is no tiny fraction, and the stamps are in their order."""
    if reader.end - start < SUFFIX.size + LONG_END.size:
        return False
    _, _, timestamp_s, mid_exposure, received, transmit = SUFFIX.unpack_from(reader.data, start)
    in_order = mid_exposure <= received <= transmit
    return bool(in_order and (timestamp_s == 0.0 or SMALLEST_TIMESTAMP_S < timestamp_s < LARGEST_TIMESTAMP_S))


def _read_end(reader: Reader, tolerant: bool) -> tuple[int, int, int, bytes]:
    """Read what follows the stamps: its size tells whether a PTP time is there, and in `tolerant` whether more is."""
    seconds, fraction, trailing, remaining = 0, 0, b"", reader.remaining
    if remaining == SHORT_END.size:
        params, tag = reader.unpack(SHORT_END)
    elif remaining == LONG_END.size:
        seconds, fraction, params, tag = reader.unpack(LONG_END)
    elif tolerant and remaining > LONG_END.size:
        seconds, fraction, params, _ = LONG_END.unpack_from(reader.data, reader.offset)
        reader.advance(LONG_END.size - NUMBER.size)
        trailing, tag = reader.take(reader.remaining - NUMBER.size), reader.integer()
    else:
        raise _wrong_end(remaining, f"{SHORT_END.size} or {LONG_END.size}")
    if tag != 0:
        raise ProtocolError(f"A NatNet FRAMEOFDATA ends with {tag:#x} instead of four zero bytes.")
    return seconds, fraction, params, trailing


def _wrong_end(remaining: int, due: object) -> ProtocolError:
    return ProtocolError(f"A NatNet FRAMEOFDATA has {remaining} bytes after its stamps; {due} are due.")
