"""What the stream makes of each packet, without sockets and with a clock that stands still."""

from __future__ import annotations

import pytest
from natnet_scripted import CLOCK_HZ, BareLink, make_packet

from bench.drivers.tracker.natnet.bitstream import Bitstream
from bench.drivers.tracker.natnet.frame import BITSTREAM_CHANGED, EDIT_MODE, MODELS_CHANGED
from bench.drivers.tracker.natnet.messages import decode_echo_request, encode_echo_response
from bench.drivers.tracker.natnet.models import encode_models
from bench.drivers.tracker.natnet.stream import ECHO_NS, POINTS_TOPIC, FrameStream
from bench.drivers.tracker.natnet.wire import Message, encode_packet, pack_text
from bench.model import ClockSample, LogEntry, Record, Severity, StampKind, TrackerFrame
from bench.timing import ManualClock

SECOND_NS = 1_000_000_000


class Setup:
    def __init__(self, bitstream: Bitstream | None = None, clock_hz: int = CLOCK_HZ) -> None:
        self.clock = ManualClock()
        self.start_ns = self.clock.now_ns()
        self.link = BareLink()
        self.records: list[Record] = []
        self.missed: list[tuple[str, int]] = []
        self.stream = FrameStream(
            self.link,
            self.clock,
            self.records.append,
            bitstream or Bitstream((4, 1, 0, 0)),
            clock_hz,
            lambda topic, n: self.missed.append((topic, n)),
        )
        self.stream.start()

    def take(self, *packets: bytes) -> None:
        for packet in packets:
            self.clock.advance_ns(10_000_000)
            self.stream.take(packet, self.clock.now_ns())

    def echo(self, round_trip_ns: int = 200_000) -> None:
        """Let the stream ask, and answer with a clock that counts microseconds since the start."""
        self.clock.advance_ns(ECHO_NS)
        self.stream.keep_up(self.clock.now_ns())
        asked = decode_echo_request(self.link.sent[-1][4:])
        self.clock.advance_ns(round_trip_ns)
        ticks = (asked + round_trip_ns // 2 - self.start_ns) // 1000
        self.stream.take(encode_echo_response(asked, ticks), self.clock.now_ns())

    def frames(self) -> list[TrackerFrame]:
        return [record for record in self.records if isinstance(record, TrackerFrame)]

    def log(self) -> list[LogEntry]:
        return [record for record in self.records if isinstance(record, LogEntry)]


@pytest.fixture
def setup() -> Setup:
    return Setup()


def test_every_frame_is_pushed_in_order(setup: Setup) -> None:
    setup.take(*(make_packet(number) for number in range(100, 110)))
    assert [frame.frame_number for frame in setup.frames()] == list(range(100, 110))
    assert setup.missed == []
    assert setup.log() == []


def test_before_the_first_echo_a_frame_is_captured_when_it_arrives(setup: Setup) -> None:
    setup.take(make_packet(100))
    assert setup.frames()[0].capture_ns == setup.frames()[0].arrival_ns == setup.clock.now_ns()


def test_after_an_echo_the_capture_time_is_the_trackers(setup: Setup) -> None:
    setup.echo()
    setup.take(make_packet(1, ticks=123_456))
    assert setup.frames()[0].capture_ns == pytest.approx(setup.start_ns + 123_456_000, abs=1000)
    (sample,) = [record for record in setup.records if isinstance(record, ClockSample)]
    assert sample.receive_ns - sample.send_ns == 200_000
    assert sample.ticks_per_s == CLOCK_HZ


def test_a_stamp_hours_away_from_its_arrival_is_not_believed(setup: Setup) -> None:
    setup.echo()
    setup.take(make_packet(1, ticks=10**13))
    assert setup.frames()[0].capture_ns == setup.frames()[0].arrival_ns


def test_clock_questions_keep_their_pace(setup: Setup) -> None:
    for _ in range(100):
        setup.stream.keep_up(setup.clock.now_ns())
        setup.clock.advance_ns(SECOND_NS // 100)
    assert setup.link.sent_messages() == [Message.ECHOREQUEST] * 4


def test_an_answer_that_nobody_asked_for_is_ignored(setup: Setup) -> None:
    setup.take(encode_echo_response(1, 2))
    assert setup.records == []


def test_an_answer_counts_once(setup: Setup) -> None:
    setup.echo()
    asked = decode_echo_request(setup.link.sent[-1][4:])
    setup.take(encode_echo_response(asked, 5))
    assert len(setup.records) == 1


def test_unanswered_questions_do_not_pile_up(setup: Setup) -> None:
    for _ in range(100):
        setup.stream.keep_up(setup.clock.now_ns())
        setup.clock.advance_ns(SECOND_NS)
    first = decode_echo_request(setup.link.sent[0][4:])
    setup.take(encode_echo_response(first, 5))
    assert setup.records == []


def test_a_gap_is_counted_and_told(setup: Setup) -> None:
    setup.take(make_packet(100), make_packet(104))
    assert setup.missed == [(POINTS_TOPIC, 3)]
    (entry,) = setup.log()
    assert entry.severity is Severity.WARN
    assert "missed: 3" in entry.text
    assert "104" in entry.text


def test_a_late_frame_is_recorded_and_the_count_corrected(setup: Setup) -> None:
    setup.take(make_packet(100), make_packet(102), make_packet(101))
    assert [frame.frame_number for frame in setup.frames()] == [100, 102, 101]
    assert setup.missed == [(POINTS_TOPIC, 1), (POINTS_TOPIC, -1)]


def test_a_doubled_frame_is_recorded_once(setup: Setup) -> None:
    setup.take(make_packet(100), make_packet(101), make_packet(101))
    assert [frame.frame_number for frame in setup.frames()] == [100, 101]
    assert "twice" in setup.log()[0].text


def test_many_gaps_are_told_once_a_second_with_their_sum(setup: Setup) -> None:
    setup.take(*(make_packet(number) for number in range(0, 200, 2)))
    setup.stream.finish()
    assert sum(n for _, n in setup.missed) == 99
    assert len(setup.log()) <= 3
    assert "99 since the start" in setup.log()[-1].text


def test_a_tracker_that_counts_anew_begins_a_segment(setup: Setup) -> None:
    setup.echo()
    setup.take(make_packet(100_000), make_packet(5, ticks=1), make_packet(6, ticks=10_001))
    assert [frame.segment for frame in setup.frames()] == [0, 1, 1]
    assert setup.missed == []
    assert any("anew" in entry.text and entry.severity is Severity.WARN for entry in setup.log())
    assert setup.link.sent_messages() == [Message.ECHOREQUEST] * 3  # at the start, by echo(), and the new clock at once
    assert setup.frames()[-1].capture_ns == setup.frames()[-1].arrival_ns  # the old map is forgotten


def test_a_broken_packet_is_counted_and_told_and_the_next_is_read(setup: Setup) -> None:
    setup.take(make_packet(100), make_packet(101)[:-8], b"", b"\x07", make_packet(102))
    setup.stream.finish()
    assert len(setup.frames()) == 2
    broken = [entry for entry in setup.log() if "cannot be read" in entry.text]
    assert all(entry.severity is Severity.WARN for entry in broken)
    assert "3 since the start" in broken[-1].text


def test_a_changed_model_list_is_asked_for_once_a_second(setup: Setup) -> None:
    setup.take(*(make_packet(number, params=MODELS_CHANGED) for number in range(150)))
    assert setup.link.sent_messages().count(Message.REQUEST_MODELDEF) == 2


def test_new_model_definitions_are_told(setup: Setup) -> None:
    setup.take(encode_models((), (4, 1)))
    assert "rigid bodies are now: none" in setup.log()[0].text


def test_edit_mode_is_told_once(setup: Setup) -> None:
    setup.take(*(make_packet(number, params=EDIT_MODE) for number in range(5)))
    assert len(setup.log()) == 1
    assert "Edit mode" in setup.log()[0].text


def test_after_a_change_of_the_bitstream_all_versions_are_tried(setup: Setup) -> None:
    setup.take(make_packet(1, params=BITSTREAM_CHANGED), make_packet(2))
    assert len(setup.frames()) == 2


def test_usb_cameras_frames_are_stamped_by_data_received(setup: Setup) -> None:
    setup.take(make_packet(1, ticks=0, received=77))
    assert setup.frames()[0].device_ticks == 77


@pytest.mark.parametrize(
    ("packet", "expected"),
    [
        (encode_packet(Message.MESSAGESTRING, pack_text("hello")), "hello"),
        (encode_packet(Message.UNRECOGNIZED_REQUEST, bytes(264)), None),
        (encode_packet(Message.SERVERINFO, bytes(279)), None),
    ],
)
def test_other_messages_disturb_nothing(setup: Setup, packet: bytes, expected: str | None) -> None:
    setup.take(packet)
    assert [entry.text.endswith(str(expected)) for entry in setup.log()] == ([True] if expected else [])


@pytest.mark.parametrize("message", [Message.DISCONNECT, Message.DISCONNECTBYTIMEOUT])
def test_a_tracker_may_take_its_leave(setup: Setup, message: Message) -> None:
    setup.take(encode_packet(message))
    assert setup.stream.is_dismissed


def test_what_a_version_to_come_brings_is_told_once_to_be_skipped() -> None:
    setup = Setup(Bitstream((4, 5, 0, 0), may_choose=False))
    setup.take(*(make_packet(number, version=(4, 5), trailing=b"more") for number in range(3)))
    (entry,) = setup.log()
    assert entry.severity is Severity.INFO
    assert "are of NatNet 4.5, and bench knows 4.3" in entry.text
    assert len(setup.frames()) == 3


def test_a_version_that_changes_is_told(setup: Setup) -> None:
    setup.take(make_packet(1, params=BITSTREAM_CHANGED), make_packet(2, version=(3, 0)))
    assert [entry.text for entry in setup.log()] == ["The tracker's frames are of NatNet 4.0, before of 4.1."]
    assert len(setup.frames()) == 2


def test_the_ptp_time_is_recorded(setup: Setup) -> None:
    setup.take(make_packet(1, ptp=(1_700_000_000, 123)))
    (frame,) = setup.frames()
    assert (frame.ptp_seconds, frame.ptp_fraction) == (1_700_000_000, 123)


def test_a_leap_of_the_frame_numbers_in_one_period_is_a_new_count_and_no_loss(setup: Setup) -> None:
    setup.take(make_packet(100), make_packet(101), make_packet(5_000, ticks=1_020_000), make_packet(5_001))
    assert setup.missed == []
    assert [frame.segment for frame in setup.frames()] == [0, 0, 1, 1]


def test_many_frames_that_take_their_time_are_missed(setup: Setup) -> None:
    setup.take(make_packet(100), make_packet(101), make_packet(5_000))
    assert setup.missed == [(POINTS_TOPIC, 4_898)]


def test_frames_of_natnet_2_are_captured_as_late_as_the_quickest_of_them() -> None:
    setup = Setup(Bitstream((2, 10, 0, 0)), clock_hz=0)
    for number, late_ns in ((100, 5_000_000), (101, 3_000_000), (102, 9_000_000)):
        packet = make_packet(number, version=(2, 10))
        setup.stream.take(packet, setup.start_ns + number * 10_000_000 + late_ns)
    frames = setup.frames()
    assert [frame.stamp for frame in frames] == [StampKind.TRACKER_TIME] * 3
    assert frames[2].capture_ns - setup.start_ns == 102 * 10_000_000 + 3_000_000
    assert setup.link.sent == []
