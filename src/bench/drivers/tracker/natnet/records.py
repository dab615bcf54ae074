"""From a FRAMEOFDATA to the record that is pushed and written."""

from __future__ import annotations

from struct import Struct

import numpy as np
import numpy.typing as npt

from bench.drivers.tracker.natnet.frame import NO_STAMP, Frame
from bench.drivers.tracker.natnet.wire import LARGEST_TICKS
from bench.errors import ProtocolError
from bench.model import NO_ID, UNLABELED, RigidBody, StampKind, TrackerFrame

__all__ = ["capture_stamp", "make_record"]

BODY_ROW = Struct("<i8fH")
"""One item of `frame.BODY`, as plain numbers."""
TRACKING_VALID = 1
NS_PER_S = 1_000_000_000
LARGEST_TIMESTAMP_S = LARGEST_TICKS / NS_PER_S
SAME_PLACE_M = 0.001
"""Another marker within this distance of a rigid body's marker is that marker."""


def capture_stamp(frame: Frame) -> tuple[int, StampKind]:
    """Return the device time of the exposure, and which moment of it that denotes.

    Ticks of the tracker's clock; before NatNet 3 nanoseconds since its software's start.

    Raises
    ------
    ProtocolError
        The frame has no stamp at all.
    """
    if 0 < frame.mid_exposure <= LARGEST_TICKS:
        return frame.mid_exposure, StampKind.MID_EXPOSURE
    if frame.mid_exposure == 0 and 0 < frame.data_received <= LARGEST_TICKS:
        return frame.data_received, StampKind.DATA_RECEIVED
    if frame.mid_exposure == NO_STAMP and 0.0 < frame.timestamp_s <= LARGEST_TIMESTAMP_S:
        return round(frame.timestamp_s * NS_PER_S), StampKind.TRACKER_TIME
    raise ProtocolError(
        f"Frame {frame.frame_number} carries no camera stamp that can be used.",
        hint="Motive must be in Live mode; a take that is played back has no capture time.",
    )


def make_record(
    frame: Frame, ticks: int, stamp: StampKind, arrival_ns: int, capture_ns: int, segment: int
) -> TrackerFrame:
    """Make the record of one frame: all points the tracker sent, in its order, and the rigid bodies."""
    labeled = frame.labeled
    if len(labeled):
        points, ids, residual = labeled["position_m"].copy(), labeled["id"].copy(), labeled["residual_m"].copy()
        flags = labeled["params"].astype(np.uint32)
    else:
        points = _free_points(frame)
        ids = np.full(len(points), NO_ID, dtype=np.uint32)
        flags = np.full(len(points), UNLABELED, dtype=np.uint32)
        residual = np.full(len(points), np.nan, dtype=np.float32)
    return TrackerFrame(
        arrival_ns=arrival_ns,
        capture_ns=capture_ns,
        frame_number=frame.frame_number,
        device_ticks=ticks,
        stamp=stamp,
        points_m=points,
        ids=ids,
        flags=flags,
        residual_m=residual,
        bodies=_make_bodies(frame) if len(frame.bodies) else (),
        segment=segment,
        ptp_seconds=frame.ptp[0],
        ptp_fraction=frame.ptp[1],
    )


def _make_bodies(frame: Frame) -> tuple[RigidBody, ...]:
    return tuple(
        RigidBody(body_id, (x, y, z), (qx, qy, qz, qw), error_m, bool(params & TRACKING_VALID))
        for body_id, x, y, z, qx, qy, qz, qw, error_m, params in BODY_ROW.iter_unpack(frame.bodies.tobytes())
    )


def _free_points(frame: Frame) -> npt.NDArray[np.float32]:
    """Return the other markers less those of rigid bodies, for a tracker that streams no labeled markers.

    The bodies' markers are known from the marker sets alone: MODELDEF's offsets cannot be turned by the pose, because
    Motive 2.1 gives them with x mirrored (seen in the recorded packets).
    """
    other = np.ascontiguousarray(frame.other_m)
    if not frame.marker_sets or not len(other):
        return other
    known = np.concatenate([one.points_m for one in frame.marker_sets])
    distance = np.linalg.norm(other[:, None, :] - known[None, :, :], axis=2)
    free: npt.NDArray[np.float32] = other[~(distance < SAME_PLACE_M).any(axis=1)]
    return free
