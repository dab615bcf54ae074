"""From frames to records."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from natnet_recording import packets_of, stored

from bench.drivers.tracker.natnet.frame import LABELED, Frame, decode_frame
from bench.drivers.tracker.natnet.records import capture_stamp, make_record
from bench.drivers.tracker.natnet.wire import Message
from bench.errors import ProtocolError
from bench.model import NO_ID, UNLABELED, StampKind, TrackerFrame


def real_frame() -> Frame:
    return decode_frame(packets_of(Message.FRAMEOFDATA)[0][4:], (3, 0))


def record_of(frame: Frame) -> TrackerFrame:
    return make_record(frame, *capture_stamp(frame), 10, 20, 3)


def test_a_record_holds_all_points_in_the_trackers_order() -> None:
    frame = real_frame()
    record = record_of(frame)
    assert np.array_equal(record.points_m, frame.labeled["position_m"])
    assert record.ids.tolist() == [131073, 131074, 131075, 131076, 131077, 50007]
    assert record.flags.tolist() == [10, 10, 10, 10, 10, 18]
    assert np.array_equal(record.residual_m, frame.labeled["residual_m"])
    assert (record.points_m.dtype, record.ids.dtype, record.flags.dtype) == (np.float32, np.uint32, np.uint32)
    assert (record.arrival_ns, record.capture_ns, record.segment, record.frame_number) == (10, 20, 3, 162_734)


def test_a_record_holds_the_rigid_bodies_and_whether_they_are_tracked() -> None:
    (body,) = record_of(real_frame()).bodies
    assert body.body_id == 2
    assert body.tracking_valid is True
    assert {type(number) for number in (*body.position_m, *body.quaternion_xyzw, body.mean_error_m)} == {float}
    assert body.position_m == pytest.approx((0.17444664, 1.4471314, -0.734304))
    assert np.linalg.norm(body.quaternion_xyzw) == pytest.approx(1.0)


def test_the_stamp_is_mid_exposure_where_the_cameras_give_it() -> None:
    frame = real_frame()
    assert capture_stamp(frame) == (frame.mid_exposure, StampKind.MID_EXPOSURE)


def test_usb_cameras_give_the_time_of_data_received() -> None:
    frame = replace(real_frame(), mid_exposure=0)
    assert capture_stamp(frame) == (frame.data_received, StampKind.DATA_RECEIVED)


@pytest.mark.parametrize(("mid", "received"), [(0, 0), (2**63, 5), (0, 2**64 - 1)])
def test_a_frame_without_a_usable_stamp_is_refused(mid: int, received: int) -> None:
    with pytest.raises(ProtocolError, match="no camera stamp"):
        capture_stamp(replace(real_frame(), mid_exposure=mid, data_received=received))


def test_without_labeled_markers_the_others_count_except_those_of_rigid_bodies() -> None:
    frame = decode_frame(stored("mocapframe_packet_occluded_v3")[4:], (3, 0))
    body_m = frame.marker_sets[0].points_m
    free_m = np.array([[1.0, 2.0, 3.0]], dtype=np.float32)
    other = np.concatenate([body_m + np.float32(0.0003), free_m])
    record = record_of(replace(frame, labeled=np.zeros(0, dtype=LABELED), other_m=other))
    assert np.array_equal(record.points_m, free_m)
    assert record.ids.tolist() == [NO_ID]
    assert record.flags.tolist() == [UNLABELED]
    assert np.isnan(record.residual_m).all()


def test_without_labeled_markers_and_marker_sets_all_others_count() -> None:
    frame = replace(real_frame(), labeled=np.zeros(0, dtype=LABELED))
    assert np.array_equal(record_of(frame).points_m, frame.other_m)


def test_an_empty_frame_is_a_record_without_points() -> None:
    empty = np.zeros((0, 3), dtype=np.float32)
    record = record_of(replace(real_frame(), labeled=np.zeros(0, dtype=LABELED), other_m=empty))
    assert record.points_m.shape == (0, 3)
