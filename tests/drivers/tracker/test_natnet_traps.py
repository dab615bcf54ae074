"""What went wrong in other clients, each once."""

from __future__ import annotations

import struct
from dataclasses import replace

import numpy as np
import pytest
from natnet_recorder import Recorder, connected
from natnet_recording import packets_of
from natnet_scripted import CLOCK_HZ, BareLink, make_packet, scripted_tracker
from test_natnet_multicast import free_port

from bench.drivers.tracker.natnet.bitstream import Bitstream
from bench.drivers.tracker.natnet.frame import Frame, decode_frame, encode_frame
from bench.drivers.tracker.natnet.records import capture_stamp, make_record
from bench.drivers.tracker.natnet.stream import FrameStream
from bench.drivers.tracker.natnet.wire import Message
from bench.errors import ProtocolError
from bench.model import UNLABELED, Record, StampKind, TrackerFrame
from bench.timing import ManualClock

V3 = (3, 0)


def real_frames() -> list[Frame]:
    return [decode_frame(packet[4:], V3) for packet in packets_of(Message.FRAMEOFDATA)]


def test_the_unlabeled_points_come_from_the_labeled_markers_and_not_from_the_other_ones() -> None:
    for frame in real_frames():
        record = make_record(frame, *capture_stamp(frame), 1, 2, 0)
        loose_m = record.points_m[(record.flags & UNLABELED) != 0]
        assert len(loose_m) == 1
        assert len(frame.other_m) == 5
        assert not (np.linalg.norm(frame.other_m - loose_m, axis=1) < 0.001).any()


def test_without_a_mid_exposure_stamp_the_time_of_reception_counts_and_the_record_says_so() -> None:
    ethernet = real_frames()[0]
    usb = replace(ethernet, mid_exposure=0)
    assert capture_stamp(ethernet) == (ethernet.mid_exposure, StampKind.MID_EXPOSURE)
    assert capture_stamp(usb) == (ethernet.data_received, StampKind.DATA_RECEIVED)


@pytest.mark.parametrize("version", [(3, 0), (4, 0), (4, 1), (4, 2), (4, 3)])
@pytest.mark.parametrize("has_ptp", [False, True])
def test_the_bytes_that_are_left_tell_whether_there_is_a_ptp_time_in_every_version(
    version: tuple[int, int], has_ptp: bool
) -> None:
    packet = encode_frame(replace(real_frames()[0], params=5), version)
    end = struct.pack("<Hi", 5, 0)
    head = packet[4 : -len(end)]
    if version >= (4, 1):
        head = head[:-8]
    frame = decode_frame(head + (struct.pack("<II", 7, 9) if has_ptp else b"") + end, version)
    assert (frame.ptp, frame.params) == ((7, 9) if has_ptp else (0, 0), 5)


@pytest.mark.parametrize("cut", range(1, 14))
def test_an_end_of_another_size_or_without_its_zeros_is_refused(cut: int) -> None:
    payload = encode_frame(replace(real_frames()[0], ptp=(1, 2), params=1), (4, 1))[4:]
    with pytest.raises(ProtocolError, match="four zero bytes" if cut == 8 else "bytes after its stamps"):
        decode_frame(payload[:-cut], (4, 1))


def test_stamps_have_eight_bytes_on_every_system() -> None:
    frame = replace(real_frames()[0], mid_exposure=2**40 + 1, data_received=2**40 + 2, transmit=2**40 + 3)
    again = decode_frame(encode_frame(frame, V3)[4:], V3)
    assert (again.mid_exposure, again.data_received, again.transmit) == (2**40 + 1, 2**40 + 2, 2**40 + 3)


def test_the_software_latency_of_natnet_2_is_four_bytes_before_the_timecode() -> None:
    frame = replace(real_frames()[0], latency_s=0.0078125, timecode=(11, 12), timestamp_s=77.25)
    packet = encode_frame(frame, (2, 10))
    again = decode_frame(packet[4:], (2, 10))
    assert (again.latency_s, again.timecode, again.timestamp_s) == (0.0078125, (11, 12), 77.25)
    assert len(packet) == len(encode_frame(replace(frame, bodies=frame.bodies[:0]), (2, 10))) + 38 + 4


def test_a_multicast_is_received_at_the_groups_address_and_not_at_our_own() -> None:
    recorder = Recorder()
    with scripted_tracker() as tracker:
        tracker.info = replace(tracker.info, is_multicast=True, data_port=free_port())
        with connected(tracker, recorder, local_address="127.0.32.5"):
            tracker.send_to_group(make_packet(100))
            assert recorder.wait_for_frame(100).frame_number == 100


def test_ids_that_change_after_a_dropout_neither_move_points_nor_count_as_more_of_them() -> None:
    clock, records = ManualClock(), list[Record]()
    stream = FrameStream(BareLink(), clock, records.append, Bitstream(V3), CLOCK_HZ, lambda _topic, _n: None)
    stream.start()
    for number, frame in enumerate(real_frames()[:20]):
        labeled = frame.labeled.copy()
        labeled["id"][-1] += number
        stream.take(encode_frame(replace(frame, labeled=labeled), V3), clock.now_ns())
    frames = [record for record in records if isinstance(record, TrackerFrame)]
    assert len(frames) == 20
    assert {len(frame.points_m) for frame in frames} == {6}
    assert len({int(frame.ids[-1]) for frame in frames}) == 20
